//! Looks: how the colours of textures are read, which decides what a policy sees.

use std::fmt;
use std::str::FromStr;

use crate::names::{UnknownName, serde_as_text};

/// How the colours of a scene's texture files are read, named by a MuJoCo version that reads them
/// so. MuJoCo 3.3.3 began to decode files that declare sRGB, which darkens them; LIBERO's
/// demonstrations, and the checkpoints trained on them, were drawn before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Look {
    /// Texture files as they are stored, as MuJoCo 2.3.7 to 3.3.2 draw them.
    #[default]
    Mujoco332,
    /// Textures decoded if their files declare sRGB, as MuJoCo 3.3.3 and later draw them.
    Mujoco333,
}

impl Look {
    /// All looks, the default first.
    pub const ALL: [Self; 2] = [Self::Mujoco332, Self::Mujoco333];

    /// Returns the look of results that name none: until looks had names, MuJoCo 3.3.7 drew every
    /// texture as it found it.
    pub const fn of_unnamed_results() -> Self {
        Self::Mujoco333
    }

    pub const fn name(self) -> &'static str {
        match self {
            Self::Mujoco332 => "mujoco-3.3.2",
            Self::Mujoco333 => "mujoco-3.3.3",
        }
    }
}

impl fmt::Display for Look {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Look {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        Self::ALL
            .into_iter()
            .find(|look| look.name() == text)
            .ok_or_else(|| UnknownName::new("look", text, &Self::ALL.map(Self::name)))
    }
}

serde_as_text!(Look);
