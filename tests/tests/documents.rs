//! Every command in the documentation works as written.

use std::path::Path;

use tests::documents::folder::checkout;
use tests::documents::visit::{failures, run_page};

/// One test per page: pages run concurrently, and the test report names the page that fails.
macro_rules! pages {
    ($($test:ident: $page:literal,)*) => {
        const PAGES: &[&str] = &[$($page),*];
        $(
            #[test]
            fn $test() {
                run_page($page);
            }
        )*
    };
}

pages! {
    commands_of_the_readme_work: "README.md",
    commands_of_architecture_work: "docs/dev/ARCHITECTURE.md",
    commands_of_the_changelog_work: "CHANGELOG.md",
    commands_of_contributing_work: "CONTRIBUTING.md",
    commands_of_cluster_work: "docs/CLUSTER.md",
    commands_of_deploying_work: "deploy/README.md",
    commands_of_containers_work: "deploy/container/README.md",
    commands_of_kubernetes_work: "deploy/kubernetes/README.md",
    commands_of_systemd_work: "deploy/systemd/README.md",
    commands_of_expert_work: "docs/dev/EXPERT.md",
    commands_of_the_family_work: "docs/FAMILY.md",
    commands_of_the_faq_work: "docs/FAQ.md",
    commands_of_the_gate_work: "docs/GATE.md",
    commands_of_the_glossary_work: "docs/GLOSSARY.md",
    commands_of_the_index_work: "docs/README.md",
    commands_of_style_work: "docs/dev/STYLE.md",
    commands_of_fidelity_work: "docs/dev/FIDELITY.md",
    commands_of_json_work: "docs/JSON.md",
    commands_of_latency_work: "docs/LATENCY.md",
    commands_of_looks_work: "docs/LOOKS.md",
    commands_of_moving_work: "docs/MOVING.md",
    commands_of_operating_work: "docs/OPERATING.md",
    commands_of_page_work: "docs/PAGE.md",
    commands_of_paraphrases_work: "docs/dev/PARAPHRASES.md",
    commands_of_performance_work: "docs/dev/PERFORMANCE.md",
    commands_of_policies_work: "docs/POLICIES.md",
    commands_of_protocol_work: "docs/PROTOCOL.md",
    commands_of_reliability_work: "docs/dev/RELIABILITY.md",
    commands_of_python_work: "docs/PYTHON.md",
    commands_of_report_work: "docs/REPORT.md",
    commands_of_simulators_work: "docs/SIMULATORS.md",
    commands_of_statistics_work: "docs/dev/STATISTICS.md",
    commands_of_the_student_work: "docs/dev/STUDENT.md",
    commands_of_why_work: "docs/WHY.md",
    commands_of_the_libero_pack_work: "assets/libero/README.md",
    commands_of_the_family_files_work: "assets/libero-family/README.md",
    commands_of_the_asset_pack_work: "assets/primitives/README.md",
    commands_of_the_examples_work: "examples/README.md",
    commands_of_fuzzing_work: "fuzz/README.md",
    commands_of_the_python_package_work: "policies/README.md",
    commands_of_the_wheels_work: "python/README.md",
    commands_of_the_shim_work: "python/libero_shim/README.md",
    commands_of_rollout_env_work: "python/rollout_env/README.md",
    commands_of_the_typescript_server_work: "policies/typescript/README.md",
    commands_of_training_work: "training/README.md",
}

#[test]
fn a_failed_command_is_reported_with_its_line_and_output() {
    let page = "\
```sh
export WORD=spoken
echo $WORD && false   # the shell stays the same
coordinator serve --data here --listen 127.0.0.1:7411
coordinator campaign status
coordinator serve --data there --listen 127.0.0.1:7411
```

<!-- file: gateway.toml -->
```toml
nonsense
```

```sh
policy-gateway --config gateway.toml
```
";
    let failures = failures("page.md", page);
    let expected: [(&str, &str); 3] = [
        ("page.md:3: the command ended with status 1", "spoken"),
        ("page.md:6: the server ended at once", "choose another address"),
        ("page.md:15: the server ended at once", "gateway.toml"),
    ];
    assert_eq!(failures.len(), expected.len(), "{failures:?}");
    for (failure, (start, output)) in failures.iter().zip(expected) {
        assert!(failure.starts_with(start), "{failure}");
        assert!(failure.contains(output), "{failure}");
    }
}

#[test]
fn every_page_has_a_test() {
    let mut found = Vec::new();
    let root = checkout();
    let mut folders = vec![root.clone()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).expect("a folder of the checkout") {
            let path = entry.expect("an entry").path();
            let name = path.file_name().and_then(|name| name.to_str());
            let name = name.unwrap_or_default();
            let is_ignored = name.starts_with('.') || ["target", "node_modules"].contains(&name);
            if path.is_dir() && !is_ignored && !path.is_symlink() {
                folders.push(path);
            } else if is_page(&path) {
                let page = path.strip_prefix(&root).expect("inside");
                found.push(page.display().to_string());
            }
        }
    }
    found.sort();
    let mut listed: Vec<&str> = PAGES.to_vec();
    listed.sort_unstable();
    assert_eq!(found, listed, "list new pages in tests/tests/documents.rs");
}

fn is_page(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "md")
}
