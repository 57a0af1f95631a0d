//! The 43 types of paraphrase: a change of the words for the object, of those for the action, or of
//! both.

use std::fmt;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Wording {
    /// Words added or left out.
    Addition,
    /// Synonyms that fit the context.
    Contextual,
    /// Synonyms in common use.
    Habitual,
    /// Two coordinate clauses.
    Coordination,
    /// A subordinate clause.
    Subordination,
    /// A statement of a need.
    Need,
    /// An imperative inside another sentence.
    Embedded,
    /// A request for permission.
    Permission,
    /// A question in place of an order.
    Question,
    Hint,
}

impl Wording {
    /// The changes of words for the action, in the order of the paper's table. The first three also
    /// apply to the words for the object.
    pub const ALL: [Self; 10] = [
        Self::Addition,
        Self::Contextual,
        Self::Habitual,
        Self::Coordination,
        Self::Subordination,
        Self::Need,
        Self::Embedded,
        Self::Permission,
        Self::Question,
        Self::Hint,
    ];
    const OF_OBJECTS: [Self; 3] = [Self::Addition, Self::Contextual, Self::Habitual];

    pub const fn mid(self) -> &'static str {
        match self {
            Self::Addition | Self::Contextual | Self::Habitual => "lexical",
            Self::Coordination | Self::Subordination => "structural",
            Self::Need | Self::Embedded | Self::Permission | Self::Question | Self::Hint => {
                "pragmatical"
            }
        }
    }

    pub const fn low(self) -> &'static str {
        match self {
            Self::Addition => "addition_deletion",
            Self::Contextual => "same_polarity_contextual",
            Self::Habitual => "same_polarity_habitual",
            Self::Coordination => "coordination",
            Self::Subordination => "subordination",
            Self::Need => "need_statement",
            Self::Embedded => "embedded_imperative",
            Self::Permission => "permission_directive",
            Self::Question => "question_directive",
            Self::Hint => "hint",
        }
    }

    const fn short(self) -> &'static str {
        match self {
            Self::Addition => "addition",
            Self::Contextual => "contextual",
            Self::Habitual => "habitual",
            Self::Coordination => "coordination",
            Self::Subordination => "subordination",
            Self::Need => "need",
            Self::Embedded => "embedded",
            Self::Permission => "permission",
            Self::Question => "question",
            Self::Hint => "hint",
        }
    }
}

/// A type of paraphrase. Displays as in the benchmark's file names: `act_pragmatical_hint`,
/// `comp_lexical+pragmatical_same_polarity_habitual+hint`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    Object(Wording),
    Action(Wording),
    Both(Wording, Wording),
}

impl Kind {
    pub fn all() -> impl Iterator<Item = Self> {
        let both = |object| Wording::ALL.map(|action| Self::Both(object, action));
        let objects = Wording::OF_OBJECTS.map(Self::Object).into_iter();
        objects
            .chain(Wording::ALL.map(Self::Action))
            .chain(Wording::OF_OBJECTS.into_iter().flat_map(both))
    }

    pub const fn high(self) -> &'static str {
        match self {
            Self::Object(_) => "obj",
            Self::Action(_) => "act",
            Self::Both(..) => "comp",
        }
    }

    pub fn mid(self) -> String {
        match self {
            Self::Object(words) | Self::Action(words) => words.mid().to_owned(),
            Self::Both(object, action) => format!("{}+{}", object.mid(), action.mid()),
        }
    }

    pub fn low(self) -> String {
        match self {
            Self::Object(words) | Self::Action(words) => words.low().to_owned(),
            Self::Both(object, action) => format!("{}+{}", object.low(), action.low()),
        }
    }

    /// Returns the short name in reports: `act hint`, `comp habitual+hint`.
    pub fn title(self) -> String {
        let high = self.high();
        match self {
            Self::Object(words) | Self::Action(words) => format!("{high} {}", words.short()),
            Self::Both(object, action) => format!("{high} {}+{}", object.short(), action.short()),
        }
    }

    /// Returns the short name in rollout ids: `obj_habitual`, `act_hint`, or `habitual_hint` for
    /// [`Self::Both`].
    pub(crate) fn label(self) -> String {
        match self {
            Self::Object(words) | Self::Action(words) => {
                format!("{}_{}", self.high(), words.short())
            }
            Self::Both(object, action) => format!("{}_{}", object.short(), action.short()),
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}_{}_{}", self.high(), self.mid(), self.low())
    }
}
