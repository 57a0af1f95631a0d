
# Adds what only the coordinator or the benchmark knows: campaigns, axes, levels and tasks.
_coordinator_and_names() {
    _coordinator "$@"
    local current="${COMP_WORDS[COMP_CWORD]}" names=""
    # Values of an option may be a list; the part after the last comma is completed.
    local list="${current%"${current##*,}"}"
    case "${COMP_WORDS[COMP_CWORD-1]}" in
        --axes) names="AXES" ;;
        --levels) names="LEVELS" ;;
        --tasks | --suites) names="SUITES" ;;
        status | pause | resume | cancel | delete | archive | list | show | retry | skip | report \
            | compare | explain | thresholds | interactions | why | export | set-priority)
            names="$("${COMP_WORDS[0]}" campaign list --json --retry-secs 0 2>/dev/null \
                | sed -n 's/^      "name": "\(.*\)",$/\1/p')"
            list=""
            ;;
    esac
    if [[ -n "$names" ]]; then
        COMPREPLY+=($(compgen -P "$list" -W "$names" -- "${current#"$list"}"))
    fi
}
complete -F _coordinator_and_names -o bashdefault -o default coordinator
