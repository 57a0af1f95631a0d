"""Constructions: the actions that tasks ask for, as clauses. The slot ``{x}`` is an object with its
article, ``{y}`` a second object, ``{a}`` and ``{b}`` two objects of equal standing; ``{to}`` is the
object's destination, ``{towards}`` the same after a verb of motion, ``{at}`` the object's position,
``{place}`` the same after "from"."""

from __future__ import annotations

from collections.abc import Mapping

from training.grammar.template import Templates
from training.grammar.things import (
    BASKET,
    BOWL,
    CABINET,
    DRAWER,
    MIDDLE,
    MOKA,
    PLAIN_BOWL,
    PLATE,
    STOVE,
    TOP,
    WHITE_MUG,
)

# fmt: off
# Lists of words are easier to read with several words to a line.

# An object is carried to a place.
CARRY: Mapping[str, Templates] = {
    "do": (
        "{take} {x} {then} {put it} {to}",
        "{take} {x} {then} {put it} {to}",
        "{take} {x} {then} {put it} {to}",
        "{take} {x} {then} {put it} {to}",
        "{put} {x} {to}",
        "{put} {x} {to}",
        "{move} {x} {to}",
        "{move} {x} {towards}",
        "{move} {x} [over|across|from where it is] {towards}",
        "{to}, {put} {x}",
        "{to} [you|you should|you must|please] {put} {x}",
        "[first|first of all|to begin|start:|initially][|,] {take} {x}[, then| and then|. then|, "
        "and next|, next|; after that|, after that| and after that] {put it} {to}",
        "after {taking} {x}, {put it} {to}",
        "[once|when|as soon as|after] you have {taken} {x}, {put it} {to}",
        "{put} {x} {to} [after|by] {taking} it",
        "[find|locate|look for|go to|reach|identify|search for|spot|move to|approach] {x}, {take} "
        "it[,|] and {put it} {to}",
        "[find|locate|look for|identify|reach for|approach] {x} {then} {move} it {to}",
        "{take} {x} so[| that] it {sits} {to}",
        "{move} {x} so[| that] it {sits} {to}",
        "{take} {x} and let it [rest|sit|lie|stand|go|down] {to}",
        "{take} {x} to {put it} {to}",
        "{take} {x}; {to} is where it [goes|belongs|should be|should go|has to go]",
        "{take} {x}, [placing it|putting it|setting it down|dropping it|moving it|laying it|"
        "depositing it] {to}",
        "get {x} {to}",
        "have {x} {was put} {to}",
        "pick {x} up {then} {put it} {to}",
        "pick {x} up {then} set it down {to}",
        "take {x} {to}",
        "take {x} {towards}",
        "{put} {x}, [which|that] you [should|must|first] {take}, {to}",
        "let {x} {be} {to}",
        "give {x} a [new |]place {to}",
        "find a [place|spot|home] for {x} {to}",
        "[perform|do|carry out] a pick and place: {x} {to}",
    ),
    "doing": (
        "{taking} {x} and {putting it} {to}", "{taking} {x} and then {putting it} {to}",
        "{putting} {x} {to}", "{moving} {x} {to}", "{moving} {x} {towards}", "getting {x} {to}",
        "{taking} {x}, then {putting it} {to}", "{taking} {x} to {put it} {to}",
    ),
    "must": (
        "{x} {goes} {to}",
        "{x} {goes} {to}",
        "{x}, {put it} {to}",
        "[the right place|the place|the destination|the new place|the target] [for|of] {x} is {to}",
        "{to} is where {x} [goes|belongs|should be|should go|has to go|is supposed to be]",
        "{want} {x} {to}",
        "{want} {x} {was put} {to}",
        "{want} {x} to [be|end up|go|sit|be {was put}] {to}",
        "there is {a x}[;|,|.| and] {take} it {then} {put it} {to}",
        "there is {a x}[;|,|.| and you should|:] {put it} {to}",
        "do you see {x}? {put it} {to}",
        "see {x}? {take} it {then} {put it} {to}",
        "{x} is in the wrong place[;|,|.] {put it} {to}",
        "{x} [is needed|is wanted|is required|is missing] {to}",
        "{x} {towards}[|, please]",
        "{x} {to}[|, please]",
        "[what|the thing|the object|the item] you [should|must|need to|have to] {put} {to} is {x}",
        "it is {x} that {goes} {to}",
    ),
    "is": (
        "{x} {sits} {to}", "{x} {sits} {to}", "{to} there is {a x}",
        "{x} has been {taken} and {was put} {to}", "you have {was put} {x} {to}",
        "{x} has been {was put} {to}", "{x} gets {to}",
    ),
    "be": ("be", "rest", "sit", "lie", "stand", "go", "be placed", "be put", "end up"),
}

# An object that is identified by its position is carried to a plate.
CARRY_FROM: Mapping[str, Templates] = {
    **CARRY,
    "do": (
        *CARRY["do"],
        "{take} {the bowl} [from|off] {place} {then} {put it} {to}",
        "{move} {the bowl} from {place} {to}",
        "{move} {the bowl} from {place} {towards}",
        "{at}, {take} {the bowl} {then} {put it} {to}",
        "{at} [there is|is|you find|you will find|stands|sits] a {bowl}[;|,|.| that you] {take} it "
        "{then} {put it} {to}",
        "{at} there is a {bowl}; {move} it {to}",
        "[look|go|reach] {at}, {take} the {bowl} [you find there|there|], {then} {put it} {to}",
        "[of the two bowls|from the bowls|among the bowls|out of the bowls], {take} the one {at} "
        "{then} {put it} {to}",
        "{move} the {bowl}, the one {at}, {to}",
        "{take} the {bowl}, [which|that] is {at}, {then} {put it} {to}",
        "{take} the {bowl}, [not the other one|not any other], that is {at}, {then} {put it} {to}",
        "{to}, {put} the {bowl} [from|that was|that is|which is] {at}",
        "{put} the {bowl} {kept} {at} {to}",
        "[as for|regarding] the {bowl} {at}, {put it} {to}",
        "{take} the one {at}, the {bowl}, {then} {put it} {to}",
    ),
    "must": (
        *CARRY["must"],
        "the {bowl} {at} {goes} {to}",
        "the {bowl}, [which is|now|currently|the one] {at}, {goes} {to}",
        "there is a {bowl} {at}[;|,|.| and] {put it} {to}",
        "{at} is a {bowl}[;|,|.| which] {goes} {to}",
        "the one {at} is the {bowl} that {goes} {to}",
    ),
    # Noun phrases for an object at its position.
    "x": (
        "the {bowl} {at}", "the {bowl} {at}", "the {bowl} {at}", "the {bowl} {kept} {at}",
        "the {bowl} {kept} {at}", "the {bowl}, which is {at},", "the {bowl}, the one {at},",
        "that {bowl} {at}", "the one {bowl} {at}",
    ),
    "a x": ("a {bowl} {at}", "a {bowl} {kept} {at}"),
    "the bowl": ("the {bowl}", "the {bowl}", "the {bowl}", "a {bowl}", "that {bowl}"),
    "bowl": BOWL,
    "to": (
        "{on} the {plate}", "{on} the {plate}", "{on} the {plate}", "{on} that {plate}",
        "{on} a {plate}", "on the surface of the {plate}", "{on} the empty {plate}",
        "in the {plate}", "at the center of the {plate}", "in the middle of the {plate}",
    ),
    "towards": (
        "to the {plate}", "over to the {plate}", "to where the {plate} is", "toward the {plate}",
    ),
    "plate": PLATE,
}

# Two objects are carried to one place.
CARRY_BOTH: Mapping[str, Templates] = {
    "do": (
        "{put} {both x} {to}",
        "{put} {both x} {to}",
        "{put} {both x} {to}",
        "{take} {both x} {then} {put them} {to}",
        "{take} {both x} {then} {put them} {to}",
        "{move} {both x} {to}",
        "{move} {both x} {towards}",
        "{put} {a} {to}[, and| and|, then|; then|, followed by| and then|. also put|. do the same "
        "with|, as well as|, together with] {b}",
        "{put} {b} {to}[, and| and|, then|; then|, followed by| and then|. also put|. do the same "
        "with|, as well as|, together with] {a}",
        "{put} {a} {to} and {put} {b} [there|in there|there too|there as well|{to} too|{to} as "
        "well|in it too]",
        "{put} {a} {to}, then {put} {b} [there|in there|there too|in it] [|as well|too|also]",
        "{put} {b} {to}, then {put} {a} [there|in there|there too|in it] [|as well|too|also]",
        "{take} {a} {then} {put it} {to}[, then|. then|; then| and then|, and] {take} {b} and {put "
        "it} {to} [|too|as well|also]",
        "{take} {b} {then} {put it} {to}[, then|. then|; then| and then|, and] {take} {a} and {put "
        "it} {to} [|too|as well|also]",
        "{take} {a} {then} {put it} {to}[, then|. then|; then| and then|, and] do the same with "
        "{b}",
        "{to}, {put} {both x}",
        "first {put} {a} {to}[, then| and then|. then|; next|, next] {b}",
        "after {putting} {a} {to}, {put} {b} [there|in there] [|as well|too|also]",
        "[collect|gather|bring together|pack|load|round up|combine|unite|gather up] {both x} {to}",
        "[fill|load|pack|stock] {the place} with {both x}",
        "get {both x} {to}",
        "have {both x} {was put} {to}",
        "[find|locate|look for|pick up] {both x}, [and |then |]{put them} {to}",
        "{put} the [two|following|two items|two things|following two|objects] {to}: {a} and {b}",
        "one after [another|the other], {put} {both x} {to}",
    ),
    "doing": (
        "{putting} {both x} {to}", "{moving} {both x} {to}",
        "{taking} {both x} and {putting them} {to}", "getting {both x} {to}",
        "{putting} {a} and then {b} {to}",
    ),
    "must": (
        "{both x} {go} {to}",
        "{both x} {go} {to}",
        "{want} {both x} {to}",
        "{want} {both x} {was put} {to}",
        "{want} {both x} to [be|end up|go] {to}",
        "{a} {goes} {to}[,| and|; so does|, and so does|, just like|, as does] {b}",
        "[the place|the right place|the destination|the target] for {both x} is {to}",
        "{to} is where {both x} [go|belong|should be|should go]",
        "[two things|two items|two objects] {go} {to}: {a} and {b}",
        "{the place} should [contain|hold|have] {both x}",
        "{the place} needs {both x}",
        "{both x}, {put them} {to}",
        "{both x} {to}[|, please]",
    ),
    "is": (
        "{both x} {sit} {to}", "{both x} {sit} {to}", "{the place} [contains|holds|has] {both x}",
        "{to} there are {both x}", "you have {was put} {both x} {to}",
    ),
    "both x": (
        "both {a} and {b}", "both {a} and {b}", "{a} and {b}", "{a} and {b}", "{b} and {a}",
        "both {b} and {a}", "{a} as well as {b}", "{a} together with {b}", "{a} along with {b}",
        "{b} together with {a}", "{a} plus {b}", "{a} and also {b}", "the two items, {a} and {b},",
        "{a} & {b}", "{b} as well as {a}", "not only {a} but also {b}",
    ),
    "put them": (
        "put them", "put them", "place them", "place them", "put both", "place both", "set them",
        "drop them", "put them both", "put both of them", "move them", "deposit them", "leave them",
        "store them", "bring them", "set both", "lay them", "drop both", "put them together",
        "transfer them", "put each",
    ),
    "putting them": (
        "putting them", "placing them", "setting them", "dropping them", "putting both",
        "placing both",
    ),
    "the place": ("the {basket}",),
    "to": (
        "{in} the {basket}", "{in} the {basket}", "{in} the {basket}", "{in} that {basket}",
        "{in} a {basket}", "in the same {basket}", "{in} the one {basket}",
    ),
    "towards": ("to the {basket}", "over to the {basket}"),
    "basket": BASKET,
}

OPEN: Mapping[str, Templates] = {
    "do": (
        "{open} {x}",
        "{open} {x}",
        "{open} {x}",
        "get {x} open",
        "pull {x} open",
        "pull {x} out",
        "slide {x} open",
        "pull {x} [towards you|outward|outwards|out of the {cabinet}|all the way out|toward you]",
        "[use|take|grab|grip|grasp|pull|hold|pull on|tug] the [handle|knob|grip] [of|on] {x} [to|"
        "and] {open} it",
        "[grab|pull|take hold of|grasp|tug on|hook] the [handle|grip] of {x}",
        "[find|go to|reach for|locate|move to|approach] {x} and {open} it",
        "[from|at|on|of] the {cabinet}, {open} the {middle} [{drawer}|one]",
        "{open} the {cabinet}, [the|at the|using the|namely the] {middle} {drawer}",
        "leave {x} [open|opened|pulled out]",
        "have {x} {opened}",
        "make {x} open",
        "give {x} a pull[| until it is open| to open it]",
        "let {x} [be open|stand open|come out]",
        "{open} only {x}",
        "[access|reveal|expose|show] the [inside|contents|interior] of {x}",
    ),
    "doing": (
        "{opening} {x}", "{opening} {x}", "getting {x} open", "pulling {x} open", "pulling {x} out",
    ),
    "must": (
        "{x} [should|must|needs to|has to|ought to] be {opened}",
        "{x} [is to|will] be {opened}",
        "{want} {x} [open|opened|pulled out|wide open]",
        "{want} {x} to be {opened}",
        "{x} should [stand|stay|be left] open",
        "{x} is [closed|shut][;|,|.| and i want it open,] {open} it",
        "{x} needs opening",
        "{x} [please|now][|, open it]",
        "{x}: {open} it",
        "i need [something from|access to|to look into|to get into|to see inside] {x}",
        "i need to put something [into|in|inside] {x}, so {open} it",
    ),
    "is": (
        "{x} is {opened}", "{x} is {opened}", "{x} has been {opened}", "{x} stands open",
        "you have {opened} {x}", "{x} is no longer [closed|shut]",
        "{x} is not [closed|shut] any more",
    ),
    "x": (
        "the {middle} {drawer} of the {cabinet}",
        "the {middle} {drawer} of the {cabinet}",
        "the {middle} {drawer} of the {cabinet}",
        "the {middle} {drawer}",
        "the {cabinet}'s {middle} {drawer}",
        "the {middle} {drawer} [in|on|at|from|inside] the {cabinet}",
        "the {drawer} in the middle of the {cabinet}",
        "the {drawer} in the [middle|center|centre]",
        "the {cabinet} {drawer} in the middle",
        "the {middle} {cabinet} {drawer}",
        "the [second|2nd] {drawer} [from the top|of the {cabinet}|down|from above|from below]",
        "the {middle} one of the [drawers|three drawers|{cabinet}'s drawers]",
        "the {drawer} between the [top|upper] and [bottom|lower] [drawers|ones]",
        "the {middle} of the three drawers",
        "the {middle} {drawer} belonging to the {cabinet}",
        "the {drawer} that is in the middle",
        "the {cabinet}'s {drawer} in the middle",
    ),
    "middle": MIDDLE,
    "drawer": DRAWER,
    "cabinet": CABINET,
}

# A drawer is opened, and an object is put inside.
OPEN_AND_PUT: Mapping[str, Templates] = {
    "do": (
        "{open} {x} {then} {put} {y} {inside}",
        "{open} {x} {then} {put} {y} {inside}",
        "{open} {x} {then} {put} {y} {inside}",
        "{open} {x} {then} {take} {y} and {put it} {inside}",
        "[first|first of all|to begin|start:|initially][|,] {open} {x}[, then| and then|. then|, "
        "next|; after that] {put} {y} {inside}",
        "after {opening} {x}, {put} {y} {inside}",
        "[once|when|as soon as] {x} is {opened}, {put} {y} {inside}",
        "with {x} {opened}, {put} {y} {inside}",
        "{put} {y} [in|into|inside] {x} [after|once|when] [you have opened it|it is {opened}|"
        "opening it|it has been {opened}]",
        "{put} {y} [in|into|inside] {x}, [which|that] you [have to|should|must|need to] {open} "
        "[first|before]",
        "{put} {y} [in|into|inside] {x}, {opening} it first",
        "{open} {x} so[| that] {y} [can go|can be {was put}|fits|may be {was put}|can be put] "
        "{inside}",
        "{open} {x} to {put} {y} {inside}",
        "{open} {x}; {y} goes {inside}",
        "[store|stow|keep|put away|hide|stash] {y} [in|inside] {x}[, opening it first| after "
        "opening it|; it must be opened first]",
        "{open} {x} for {y}[, then| and] {put it} {inside}",
        "{move} {y} into {x} after {opening} it",
    ),
    "doing": (
        "{opening} {x} and {putting} {y} {inside}",
        "{opening} {x} and then {putting} {y} {inside}",
        "{putting} {y} [in|into|inside] {x} after {opening} it",
        "{opening} {x} to {put} {y} {inside}",
    ),
    "must": (
        "{y} {goes} [in|into|inside] {x}, which [must|has to|needs to|should] be {opened} [first|"
        "before]",
        "{x} [should|must|needs to|has to] be {opened} and {y} {was put} {inside}",
        "{x} [should|must|needs to|has to] be {opened}, [then|and then|and after that] {y} {goes} "
        "{inside}",
        "{want} {x} {opened} and {y} {inside}",
        "{want} {y} inside {x}, so {open} it first",
        "{y} {goes} [in|inside] {x}[;|,] so {open} it[| first]",
        "{x} is [closed|shut][;|,|.] {open} it {then} {put} {y} {inside}",
    ),
    "is": (
        "{x} is {opened} and {y} {sits} {inside}",
        "{y} {sits} [in|inside] {x}, which you [opened|have opened]",
        "{y} {sits} [in|inside] the {opened} {drawer}, the {top} one",
        "{x} has been {opened} and {y} has been {was put} {inside}",
    ),
    "x": (
        "the {top} {drawer}", "the {top} {drawer}", "the {top} {drawer}",
        "the {top} {drawer} of the {cabinet}", "the {cabinet}'s {top} {drawer}",
        "the {top} {drawer} [in|on|at|from] the {cabinet}", "the {drawer} at the top",
        "the {drawer} at the top of the {cabinet}", "the {top} one of the drawers",
        "the {cabinet} {drawer} at the top", "the {top} {cabinet} {drawer}",
        "the [first|1st] {drawer} from the top", "the {drawer} on top",
        "the {top} of the three drawers",
    ),
    "y": ("the {bowl}", "the {bowl}", "the {bowl}", "that {bowl}", "a {bowl}", "this {bowl}"),
    "inside": (
        "inside", "inside", "in it", "into it", "inside it", "there", "in there", "within",
        "inside of it", "into the {drawer}", "in the {drawer}", "inside the {drawer}", "within it",
        "in that {drawer}", "in",
    ),
    "top": TOP,
    "drawer": DRAWER,
    "bowl": PLAIN_BOWL,
    "cabinet": CABINET,
}

PUSH: Mapping[str, Templates] = {
    "do": (
        "{push} {x} {to}",
        "{push} {x} {to}",
        "{push} {x} {to}",
        "{push} {x} {to}",
        "{push} {x} [along the table|across the table|over|forward|sideways|on the table|over the "
        "table|along] {to}",
        "{push} {x} until it {sits} {to}",
        "{push} {x} so[| that] it {sits} {to}",
        "{to}, {push} {x}",
        "get {x} {to}",
        "[without lifting it|without picking it up|by pushing|by sliding][,|] {push} {x} {to}",
        "{put} {x} {to} by {pushing} it",
        "{put} {x} {to}",
        "{push} {x}; it should [be|end up|stop] {to}",
        "[touch|reach|find|go to|approach] {x} and {push} it {to}",
        "give {x} a push {to}",
        "have {x} {pushed} {to}",
        "[apply a push to|press against] {x} [until|so that] it {sits} {to}",
    ),
    "doing": (
        "{pushing} {x} {to}", "{pushing} {x} {to}", "{pushing} {x} until it {sits} {to}",
        "getting {x} {to}",
    ),
    "must": (
        "{x} [should|must|needs to|has to|ought to] be {pushed} {to}",
        "{x} [should|must|needs to|has to] [go|move|slide|be|end up] {to}",
        "{want} {x} {to}",
        "{want} {x} {pushed} {to}",
        "{x} belongs {to}",
        "{to} is where {x} [goes|belongs|should be|should go]",
        "{x} is to be {pushed} {to}",
        "{x} {to}[|, please]",
        "the place for {x} is {to}",
    ),
    "is": (
        "{x} {sits} {to}", "{x} has been {pushed} {to}", "you have {pushed} {x} {to}",
        "{x} reaches [|the place ]{to}",
    ),
    "x": ("the {plate}", "the {plate}", "the {plate}", "that {plate}", "this {plate}", "a {plate}"),
    "to": (
        "to the front of the {stove}", "to the front of the {stove}", "to the front of the {stove}",
        "in front of the {stove}", "in front of the {stove}", "toward the front of the {stove}",
        "towards the front of the {stove}", "to the {stove}'s front",
        "to the area in front of the {stove}", "before the {stove}", "at the front of the {stove}",
        "to the front side of the {stove}",
        "to the [place|spot|space|position|region] in front of the {stove}",
        "up to the front of the {stove}", "to the front [part|edge|end] of the {stove}",
        "at the {stove}'s front", "ahead of the {stove}", "just in front of the {stove}",
        "right in front of the {stove}", "into the space before the {stove}",
        "to the front, where the {stove} is", "directly in front of the {stove}",
        "close to the front of the {stove}",
    ),
    "plate": PLATE,
    "stove": STOVE,
}

TURN_ON: Mapping[str, Templates] = {
    "do": (
        "{turn on} {x}",
        "{turn on} {x}",
        "{turn on} {x}",
        "{turn} {x} on",
        "{turn} {x} on",
        "get {x} [going|started|running|hot|working|lit]",
        "[turn|twist|rotate|use|operate|move] the [knob|dial|switch|control|button] [of|on|for] "
        "{x}[| to turn it on| to start it| until it is on]",
        "[turn|twist|rotate] {x}'s [knob|dial|switch]",
        "make {x} [hot|work|run|start|warm]",
        "start [heating|cooking] with {x}",
        "[find|go to|locate|approach|reach for] {x} and [turn|switch] it on",
        "have {x} {turned on}",
        "bring {x} [to life|into operation|up to heat]",
        "let {x} [heat up|burn|run|get hot]",
        "give {x} some heat",
        "start the [heat|fire|flame] of {x}",
        "set {x} to on",
        "put {x} [into operation|in use|to on]",
        "[turn|switch] on the [heat|fire|flame|heating] [of|on] {x}",
    ),
    "doing": (
        "{turning on} {x}", "{turning on} {x}", "turning {x} on", "switching {x} on",
        "getting {x} going",
    ),
    "must": (
        "{x} [should|must|needs to|has to|ought to] be {turned on}",
        "{x} is to be {turned on}",
        "{want} {x} {turned on}",
        "{want} {x} to be {turned on}",
        "{x} is [off|cold|not on][;|,|.] [turn|switch] it on",
        "{x} should [run|heat up|burn|be heating]",
        "{x}: [turn|switch] it on",
        "i [want|am going|plan|need] to cook[,|;] so {turn on} {x}",
        "{x} needs [turning|switching] on",
        "{x} on[|, please]",
        "it is cold[;|,] {turn on} {x}",
    ),
    "is": (
        "{x} is {turned on}", "{x} is {turned on}", "{x} has been {turned on}",
        "you have {turned on} {x}", "{x} is no longer off", "{x} gets hot", "{x} heats up",
    ),
    "x": (
        "the {stove}", "the {stove}", "the {stove}", "the {stove}", "that {stove}", "this {stove}",
        "our {stove}", "the {stove} on the table",
    ),
    "stove": STOVE,
}

TURN_ON_AND_PUT: Mapping[str, Templates] = {
    "do": (
        "{turn on} {x} {then} {put} {y} {on it}",
        "{turn on} {x} {then} {put} {y} {on it}",
        "{turn on} {x} {then} {put} {y} {on it}",
        "{turn} {x} on {then} {put} {y} {on it}",
        "{turn on} {x} {then} {take} {y} and {put it} {on it}",
        "[first|first of all|to begin|start:][|,] {turn on} {x}[, then| and then|. then|, next|; "
        "after that] {put} {y} {on it}",
        "after {turning on} {x}, {put} {y} {on it}",
        "[once|when|as soon as] {x} is {turned on}, {put} {y} {on it}",
        "with {x} {turned on}, {put} {y} {on it}",
        "{put} {y} {on} {x} [after|once] [it is {turned on}|turning it on|you have turned it on]",
        "{turn on} {x} and use it [for|to heat] {y}[|, putting it on top]",
        "{put} {y} {on} {x}, [turning it on|switching it on|lighting it] first",
        "{put} {y} {on} {x} and {turn on} [it|the {stove}]",
        "{turn on} {x}; {y} goes {on it}",
        "{turn on} {x} so[| that] {y} can be {was put} {on it}",
        "[start|get] {x} [heating|going] {then} {put} {y} {on it}",
        "[heat|warm up|brew with|make coffee with] {y} [on|by putting it on] {x}, [which has to be "
        "turned on|turning it on first|after switching it on]",
        "{put} {y} {on} the {turned on} {stove}",
        "{turn on} {x} for {y} {then} {put it} {on it}",
    ),
    "doing": (
        "{turning on} {x} and {putting} {y} {on it}",
        "{turning on} {x} and then {putting} {y} {on it}",
        "{putting} {y} {on} {x} after {turning on} it",
        "turning {x} on and {putting} {y} {on it}",
    ),
    "must": (
        "{x} [should|must|needs to|has to] be {turned on} and {y} {was put} {on it}",
        "{x} [should|must|needs to|has to] be {turned on}, [then|and then|and] {y} {goes} {on it}",
        "{want} {x} {turned on} and {y} {on it}",
        "{y} {goes} {on} {x}, which [must|should|has to|needs to] be {turned on} [first|too|as "
        "well]",
        "{want} coffee[;|,|:] {turn on} {x} {then} {put} {y} {on it}",
        "{want} {x} {turned on} with {y} {on it}",
        "{x} is off[;|,|.] [turn|switch] it on {then} {put} {y} {on it}",
    ),
    "is": (
        "{x} is {turned on} and {y} {sits} {on it}",
        "{y} {sits} {on} {x}, which is {turned on}",
        "{x} is {turned on} with {y} {on it}",
        "{y} {sits} {on} the {turned on} {stove}",
        "{x} has been {turned on} and {y} has been {was put} {on it}",
    ),
    "x": ("the {stove}", "the {stove}", "the {stove}", "that {stove}"),
    "y": ("the {moka}", "the {moka}", "the {moka}", "that {moka}", "a {moka}"),
    "on it": (
        "on it", "on it", "on top of it", "onto it", "on top", "upon it", "atop it", "there",
        "on the {stove}", "on the burner", "on the hot plate", "on its surface", "over it",
        "on the heat",
    ),
    "stove": STOVE,
    "moka": MOKA,
}

# An object is put into a container, which is then closed.
PUT_AND_CLOSE: Mapping[str, Templates] = {
    "do": (
        "{put} {y} {in} {x} {then} {close} {it}",
        "{put} {y} {in} {x} {then} {close} {it}",
        "{put} {y} {in} {x} {then} {close} {it}",
        "{take} {y}, {put it} {in} {x}[,|] {then} {close} {it}",
        "{take} {y} {then} {put it} {in} {x}[, then|, and then| and] {close} {it}",
        "{move} {y} into {x} {then} {close} {it}",
        "after {putting} {y} {in} {x}, {close} {it}",
        "[first|first of all|to begin|start:][|,] {put} {y} {in} {x}[, then| and then|. then|, "
        "next|; after that] {close} {it}",
        "[once|when|as soon as] {y} is {in} {x}, {close} {it}",
        "{put} {y} {in} {x}, {closing} it [afterwards|after that|when done|behind it|]",
        "{close} {x} [after|once] [you have |]{putting} {y} {in} it",
        "{close} {x} with {y} inside",
        "shut {y} [in|inside|up in] {x}",
        "{in} {x}, {put} {y}[, then| and| and then] {close} {it}",
        "[store|stow|keep|lock|stash|hide|put away] {y} in {x}[, then| and| and then] {close} {it}",
        "{put} {y} {in} {x} [and make sure|, making sure] {it} is {closed}",
        "{put} {y} {in} {x} so[| that] you can {close} {it}",
        "get {y} {in} {x} {then} {close} {it}",
        "{close} {x} as soon as {y} is inside",
    ),
    "doing": (
        "{putting} {y} {in} {x} and {closing} {it}",
        "{putting} {y} {in} {x} and then {closing} {it}",
        "{taking} {y}, {putting it} {in} {x} and {closing} {it}",
        "{closing} {x} after {putting} {y} {in} it",
    ),
    "must": (
        "{y} {goes} {in} {x}, [which|and it|and that] [should|must|needs to|has to] be {closed}[| "
        "afterwards| after that]",
        "{y} [should|must|needs to|has to] be {was put} {in} {x} and {it} {closed}",
        "{want} {y} {in} {x} and {it} {closed}",
        "{want} {x} {closed} with {y} inside",
        "{y} {goes} {in} {x}[;|.|, then] {close} {it}[| afterwards| after that]",
        "{x} should [contain|hold] {y} and be {closed}",
        "{y} {goes} {in} {x} before you {close} {it}",
    ),
    "is": (
        "{y} {sits} {in} {x} and {it} is {closed}",
        "{x} is {closed} with {y} inside",
        "{y} {sits} inside the {closed} {thing}",
        "{y} has been {was put} {in} {x} and {it} has been {closed}",
        "{x}, with {y} inside, is {closed}",
    ),
}

# Two objects are carried to two places.
PUT_TWO: Mapping[str, Templates] = {
    "do": (
        "{put} {a} {to a}[ and|, and|, then| and then|;|. then|, and then|, and also|, while you] "
        "{put} {b} {to b}",
        "{put} {a} {to a}[ and|, and|, then| and then|;|. then|, and then|, and also] {put} {b} "
        "{to b}",
        "{put} {a} {to a}[ and|, and|, then|;|, while|, with] {b} {to b}",
        "{put} {b} {to b}[ and|, and|, then| and then|;|. then|, and then] {put} {a} {to a}",
        "{put} {b} {to b}[ and|, and|, then|;|, with] {a} {to a}",
        "{take} {a} {then} {put it} {to a}[, then|. then|; then| and then|, and] {take} {b} and "
        "{put it} {to b}",
        "{take} {b} {then} {put it} {to b}[, then|. then|; then| and then|, and] {take} {a} and "
        "{put it} {to a}",
        "[first|first of all|to begin|start:][|,] {put} {a} {to a}[, then| and then|. then|, next|"
        "; after that] {put} {b} {to b}",
        "after {putting} {a} {to a}, {put} {b} {to b}",
        "[once|when|as soon as] {a} is {to a}, {put} {b} {to b}",
        "{to a} {put} {a}, [and|then] {to b} {put} {b}",
        "{to a}, {put} {a}; {to b}, {put} {b}",
        "{move} {a} {to a} and {move} {b} {to b}",
        "get {a} {to a} and {b} {to b}",
        "have {a} {to a} and {b} {to b}",
        "[arrange|set up|sort] [the things|things|the objects|the items|everything]: {a} {to a}[ "
        "and|,|;] {b} {to b}",
        "take {a} {to a} and [take |]{b} {to b}",
    ),
    "doing": (
        "{putting} {a} {to a} and {putting} {b} {to b}",
        "{putting} {a} {to a} and {b} {to b}",
        "{moving} {a} {to a} and {b} {to b}",
        "{putting} {b} {to b} and {a} {to a}",
    ),
    "must": (
        "{a} {goes} {to a}[ and|, and|;|,|, while|, whereas] {b} {goes} {to b}",
        "{a} {goes} {to a}[ and|, and|,|;] {b} {to b}",
        "{b} {goes} {to b}[ and|, and|;|,] {a} {goes} {to a}",
        "{want} {a} {to a} and {b} {to b}",
        "{a} {to a}[,| and|;] {b} {to b}[|, please]",
        "{want} {a} {was put} {to a} and {b} {was put} {to b}",
        "{want} {b} {to b} and {a} {to a}",
    ),
    "is": (
        "{a} {sits} {to a} and {b} {sits} {to b}",
        "{a} {sits} {to a} and {b} {to b}",
        "{b} {sits} {to b} and {a} {sits} {to a}",
        "{a} has been {was put} {to a} and {b} {to b}",
    ),
    "a": ("the {white mug}",),
    "white mug": WHITE_MUG,
}
