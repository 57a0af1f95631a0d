"""Whole sentences around a clause."""

from collections.abc import Mapping

from training.grammar.template import Templates

# fmt: off
# Lists of words are easier to read with several words to a line.

FRAMES: Mapping[str, Templates] = {
    "do": (
        "please {do}",
        "{do}[, please| please| now| for me| if you can| if you would| right away| when you are "
        "ready]", "[gently|carefully|slowly|quickly|now|next|just|simply|safely] {do}",
        "[could|can|will|would] you [|please |kindly |maybe |possibly ]{do}[|, please| for me]?",
        "[i want|i need|i would like|i'd like|we want|we need] you to {do}",
        "[your|the] [task|job|goal|objective|mission|assignment|aim|next step|duty] is to {do}",
        "[task|goal|instruction|command|objective|to do|next|step one]: {do}",
        "[you should|you need to|you have to|you must|you are to|you ought to|you can] [|now ]{do}",
        "[robot|hey robot|hello|ok|okay|alright|hey|now then], {do}",
        "[go ahead and|go and|proceed to|try to|be sure to|make sure to|make sure you|remember to|"
        "do not forget to|help me|help me to|let us|let's|see if you can|see that you|attempt to] "
        "{do}",
        "[use|with|using] [the|your] [arm|gripper|robot arm|hand|robotic arm|manipulator][| to|,] "
        "{do}", "[it is time|it's time|time|we have|there is a need] to {do}",
        "[would it be possible|is it possible|are you able] to {do}?",
        "[i was wondering|i wonder] if you could {do}",
        "[what i need is for you|the thing to do is|all you have to do is|what you have to do is|"
        "the plan is|the idea is|what we want is] to {do}",
        "in this [scene|room|setting|kitchen|workspace], {do}", "[kindly|do|please do] {do}",
        "[in order ]to [finish|complete|solve] [this|the task|the job], {do}",
    ),
    "doing": (
        "[would|do] you mind {doing}?",
        "[your|the] [task|job|goal|objective|assignment|aim] [is|involves|consists of|requires|"
        "comes down to|calls for] {doing}",
        "[i need help|help me|i need you to help me|assist me in|assist with|help with|try|start|"
        "begin by|please start|take care of|see to|see about|i suggest|how about|what about|work "
        "on|be in charge of|we need help|go about|get on with|please handle|you are responsible "
        "for] {doing}", "[finish|complete|do] [the job|the task|this|this task] by {doing}",
        "[tidy up|help|help out|clean up|sort things out|be useful] by {doing}",
        "{doing}[| is the task| is what i want| is your job| is what you should do| is the goal| "
        "is needed| would be great| would help]",
    ),
    "must": (
        "{must}", "{must}[|, please| now]",
        "[i think|i believe|remember,|note that|as requested,|please see to it:|now|ok,|so|well,|"
        "listen:|as a next step,|you know,] {must}",
    ),
    "is": (
        "[make sure|make certain|ensure|see to it|see|check|be sure|take care|guarantee][| that] "
        "{is}", "[arrange|set|organize|organise|rearrange|fix] [things|it|the scene|the objects|"
        "everything] so[| that] {is}",
        "[i want it so that|i want to see that|i want|i would like it if|i'd like it if|i would be "
        "happy if|it would be good if|it would be nice if|what i want is that|what matters is "
        "that] {is}",
        "[the task|the job|your work|this|everything|the goal] is [done|complete|finished|over|"
        "solved|achieved|reached] [when|once|as soon as] {is}",
        "[do not stop|work|keep going|continue|carry on] until {is}",
        "[in the end|at the end|finally|when you are done|afterwards|by the end|when finished|once "
        "you are done|as a result], {is}",
        "[goal|target state|desired result|target|wanted|end state|outcome|objective]: {is}",
        "[do|act|move|work|proceed] [|so |such |in a way ]that {is}",
        "[your|the] [goal|task|job|objective|aim] is to [make sure|ensure|see to it|get it so] "
        "that {is}",
    ),
}
