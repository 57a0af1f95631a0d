"""Verbs and small words for all tasks. A repeated word is drawn more often. Forms of a verb have
slots of their own: ``put``, ``putting``, and ``was put`` for the participle, without "was". ``goes``
and ``sits`` follow one object, ``go`` and ``sit`` two."""

from training.grammar.template import Grammar

# fmt: off
# Lists of words are easier to read with several words to a line.

COMMON: Grammar = {
    "take": (
        "pick up", "pick up", "pick up", "grab", "grab", "take", "take", "lift", "lift up", "get",
        "grasp", "pick", "fetch", "collect", "raise", "seize", "retrieve", "take hold of",
        "get hold of", "clutch", "grip", "hold", "gather", "acquire", "catch", "reach for",
        "select", "choose", "remove", "obtain", "scoop up", "hoist", "snatch", "take up",
        "gather up",
    ),
    "taking": (
        "picking up", "picking up", "grabbing", "taking", "lifting", "lifting up", "getting",
        "grasping", "picking", "fetching", "collecting", "raising", "retrieving", "taking hold of",
        "gripping", "holding", "gathering", "reaching for", "removing", "selecting",
    ),
    "taken": (
        "picked up", "picked up", "grabbed", "taken", "lifted", "grasped", "gripped", "fetched",
        "collected", "retrieved", "got", "raised", "gathered", "got hold of",
    ),
    "put": (
        "put", "put", "put", "place", "place", "place", "set", "set", "lay", "position", "deposit",
        "drop", "rest", "leave", "put down", "set down", "lay down", "lower", "stow", "store",
        "stick", "release", "arrange", "locate", "let go of", "situate", "settle", "park", "plop",
        "ease",
    ),
    "put it": (
        "put it", "put it", "put it", "place it", "place it", "place it", "set it", "set it",
        "lay it", "position it", "deposit it", "drop it", "rest it", "leave it", "put it down",
        "set it down", "set it gently", "place it down", "place it carefully", "lay it down",
        "lower it", "stow it", "stick it", "release it", "let it go", "move it", "bring it",
        "transfer it", "carry it", "take it over and put it", "transport it and set it", "store it",
        "let it rest", "drop it off", "deliver it", "return it", "shift it", "relocate it",
        "settle it", "keep it", "put the item", "place the object", "set the thing", "have it sit",
        "bring it over and place it",
    ),
    "putting": (
        "putting", "putting", "placing", "placing", "setting", "laying", "positioning",
        "depositing", "dropping", "resting", "leaving", "setting down", "putting down", "lowering",
        "storing", "stowing", "arranging",
    ),
    "putting it": (
        "putting it", "placing it", "setting it", "laying it", "positioning it", "depositing it",
        "dropping it", "moving it", "bringing it", "leaving it", "setting it down", "lowering it",
        "transferring it", "resting it", "storing it", "delivering it",
    ),
    "was put": (
        "put", "placed", "placed", "set", "laid", "positioned", "deposited", "dropped", "set down",
        "put down", "moved", "stored", "left", "located", "brought", "transferred", "stowed",
        "laid down", "lowered", "relocated", "delivered", "arranged", "settled",
    ),
    "move": (
        "move", "move", "transfer", "bring", "carry", "shift", "relocate", "transport", "take",
        "deliver", "convey", "get", "haul", "pass", "reposition", "lift", "send", "drop",
    ),
    "moving": (
        "moving", "transferring", "bringing", "carrying", "shifting", "relocating", "transporting",
        "taking", "delivering", "getting", "repositioning", "conveying",
    ),
    "sits": (
        "is", "is", "is", "sits", "rests", "stands", "lies", "is placed", "is located",
        "is sitting", "is resting", "is lying", "is standing", "ends up", "has been placed",
        "is positioned", "stays", "gets placed", "winds up", "lands", "comes to rest", "remains",
        "finds its place", "is set", "has been put", "has its place", "is found", "gets put",
    ),
    "sit": (
        "are", "are", "are", "sit", "rest", "stand", "lie", "are placed", "are located", "end up",
        "have been placed", "are positioned", "get placed", "land", "come to rest", "wind up",
        "are both", "have both been put", "are found", "are sitting", "are together",
    ),
    "goes": (
        "goes", "belongs", "should go", "needs to go", "has to go", "must go", "should be",
        "needs to be", "must be", "should be {was put}", "needs to be {was put}",
        "must be {was put}", "has to be {was put}", "is to be {was put}", "ought to be {was put}",
        "should end up", "is supposed to be", "is meant to be", "is to go", "wants to be",
        "should sit", "should rest", "should be picked up and {was put}",
        "needs to be taken and {was put}", "should be {taken} and {was put}", "will be {was put}",
        "can be {was put}", "may go", "gets {was put}", "is going", "should now be {was put}",
        "has its place", "should stand", "should lie",
    ),
    "go": (
        "go", "belong", "should go", "need to go", "have to go", "must go", "should be",
        "need to be", "must be", "should be {was put}", "need to be {was put}", "must be {was put}",
        "have to be {was put}", "are to be {was put}", "ought to be {was put}", "should end up",
        "should both be {was put}", "should both go", "both belong", "both go",
        "are both to be {was put}", "both need to be {was put}", "should be together",
        "should be {taken} and {was put}",
    ),
    "then": (
        "and", "and", "and then", ", then", ", and then", "then", "before you", ", after that",
        "; then", "and afterwards", ", next", "and next", ". then", "and subsequently",
        "and after that", ". after that,", ", finally", ", and finally", "so you can",
    ),
    "want": (
        "i want", "i need", "i would like", "i'd like", "we want", "we need", "let's get", "get",
        "have", "i want you to get", "please get", "can you get", "could you get",
        "i would like to see", "i want to see", "i want to have", "help me get", "let me have",
    ),
    "kept": (
        "located", "sitting", "standing", "resting", "lying", "placed", "found", "positioned",
        "situated", "set", "that is", "which is", "that sits", "that rests", "that lies",
        "that stands", "which sits", "which rests", "currently", "that you find", "that is located",
        "that is sitting", "that is placed", "which stands", "you see", "seen", "that was put",
        "that was left",
    ),
    "open": (
        "open", "open", "open", "open up", "pull open", "pull out", "slide open", "slide out",
        "draw out", "draw open", "unclose", "extend", "tug open", "get open", "pull", "unshut",
    ),
    "opening": (
        "opening", "opening", "opening up", "pulling open", "pulling out", "sliding open",
        "sliding out", "drawing out", "pulling", "extending", "tugging open",
    ),
    "opened": (
        "opened", "open", "pulled open", "pulled out", "slid open", "slid out", "drawn out",
        "wide open", "fully open", "extended", "opened up",
    ),
    "close": (
        "close", "close", "shut", "shut", "close up", "push shut", "push closed", "seal",
        "slide shut", "swing shut", "fasten", "pull closed", "secure",
    ),
    "closing": ("closing", "closing", "shutting", "pushing shut", "sealing", "closing up"),
    "closed": (
        "closed", "closed", "shut", "shut", "pushed shut", "sealed", "closed up", "shut again",
        "closed again", "fully closed",
    ),
    "turn on": (
        "turn on", "turn on", "switch on", "switch on", "light", "start", "ignite", "activate",
        "power on", "power up", "fire up", "light up", "start up", "enable", "engage", "heat up",
        "turn up", "set off", "flip on", "spark up", "energize", "kindle", "put on",
        "turn the knob of", "twist the knob of", "rotate the knob of", "turn the dial of",
        "operate the knob of", "use the knob to turn on", "turn the knob to start",
        "twist the dial to switch on", "turn the control of", "set the heat of",
    ),
    "turn": ("turn", "switch", "power", "flick", "flip", "put", "get"),
    "turning on": (
        "turning on", "turning on", "switching on", "lighting", "starting", "igniting",
        "activating", "powering on", "powering up", "firing up", "lighting up", "heating up",
        "turning the knob of", "rotating the knob of", "starting up", "engaging",
    ),
    "turned on": (
        "turned on", "on", "switched on", "lit", "started", "ignited", "activated", "powered on",
        "powered up", "fired up", "running", "burning", "hot", "heating", "heated up", "working",
        "in operation", "operating", "active", "going", "glowing",
    ),
    "push": (
        "push", "push", "push", "slide", "slide", "move", "shove", "nudge", "shift", "drag",
        "press", "scoot", "guide", "steer", "relocate", "reposition", "advance", "propel", "sweep",
        "bring", "glide", "pull", "force", "ease",
    ),
    "pushing": (
        "pushing", "pushing", "sliding", "moving", "shoving", "nudging", "shifting", "dragging",
        "pressing", "scooting", "bringing", "guiding", "repositioning",
    ),
    "pushed": (
        "pushed", "pushed", "slid", "moved", "shoved", "nudged", "shifted", "dragged", "pressed",
        "brought", "repositioned", "guided",
    ),
    "on": ("on", "on", "on", "onto", "onto", "on to", "on top of", "upon", "atop", "over"),
    "in": ("in", "in", "in", "into", "into", "inside", "inside", "inside of", "within"),
    "next to": (
        "next to", "next to", "beside", "beside", "near", "by", "close to", "adjacent to",
        "alongside", "right next to", "at the side of", "by the side of", "to the side of",
        "right beside", "directly beside", "directly next to", "just beside", "nearest to",
        "closest to", "in the vicinity of", "neighboring", "neighbouring", "touching", "along with",
        "near to", "nearby", "immediately next to",
    ),
    "between": (
        "between", "between", "in between", "in the space between", "in the gap between",
        "midway between", "halfway between", "sandwiched between", "in the middle of",
        "right between", "somewhere between", "in the middle between", "amid", "wedged between",
        "placed between", "flanked by", "surrounded by",
    ),
    "both": (
        "both", "the two", "both of the", "the pair of", "the two of the", "two", "each of the",
    ),
}
