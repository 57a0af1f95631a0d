//! Problem classes of LIBERO-Plus: 1,919 names in its BDDL files in addition to LIBERO's
//! five. Each is one of LIBERO's classes with a different scene file or different textures, which
//! the name of the class encodes.

use std::fmt;

/// Files that a variant needs in addition to its BDDL file and states.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Assets {
    /// LIBERO's own, 585 files.
    Libero,
    /// Thirteen additional objects in LIBERO-Plus' archive.
    NewObjects,
    /// 998 scenes with different lights.
    Lights,
    /// 148 textures for floors and walls.
    FloorTextures,
    /// 508 scenes with different tables and backgrounds, and their textures.
    Scenes,
}

impl Assets {
    pub const ALL: [Self; 5] =
        [Self::Libero, Self::NewObjects, Self::Lights, Self::FloorTextures, Self::Scenes];

    pub const fn words(self) -> &'static str {
        match self {
            Self::Libero => "LIBERO's own files",
            Self::NewObjects => "objects of LIBERO-Plus' archive (new_objects/)",
            Self::Lights => "scenes of LIBERO-Plus' archive (scenes/lights/)",
            Self::FloorTextures => "floor and wall textures of LIBERO-Plus' archive (textures/)",
            Self::Scenes => "table and background scenes of LIBERO-Plus' archive (scenes/)",
        }
    }
}

impl fmt::Display for Assets {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.words())
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Style {
    /// File in the textures' folder.
    pub file: String,
    /// True if the texture is one of LIBERO's.
    pub is_liberos: bool,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ProblemClass {
    /// LIBERO's class, in lower case.
    pub parent: &'static str,
    /// Scene file that replaces the parent's, relative to the assets' folder.
    pub scene: Option<String>,
    pub floor: Option<Style>,
    pub wall: Option<Style>,
}

/// LIBERO's classes, with the prefix of their scene files.
const PARENTS: [(&str, &str); 5] = [
    ("libero_living_room_tabletop_manipulation", "liv"),
    ("libero_kitchen_tabletop_manipulation", "kitchen"),
    ("libero_study_tabletop_manipulation", "study"),
    ("libero_tabletop_manipulation", "tabletop"),
    ("libero_floor_manipulation", "floor"),
];

/// Floor styles and the names of their files; the first twelve are LIBERO's. The file of any other
/// style has the style's name.
const FLOORS: [(&str, &str); 25] = [
    ("dark", "dark_floor_texture.png"),
    ("rustic", "rustic_floor.png"),
    ("light_gray", "light-gray-floor-tile.png"),
    ("white_marble", "white_marble_floor.png"),
    ("wood_plank", "seamless_wood_planks_floor.png"),
    ("brown_ceramic", "brown_ceramic_tile.png"),
    ("gray_ceramic", "gray_ceramic_tile.png"),
    ("tile_grigia_caldera", "tile_grigia_caldera_porcelain_floor.png"),
    ("dapper_gray", "dapper_gray_floor.png"),
    ("gray", "gray_floor.png"),
    ("light", "light_floor.png"),
    ("marble", "marble_floor.png"),
    ("brick_disp", "Bricks02_DISP_6K.png"),
    ("cliffde_ao", "CliffDesert006_AO_HIRES.png"),
    ("cobble01_ao", "Cobblestone01_AO_6K.png"),
    ("marble01_col", "Marble01_COL_3K.png"),
    ("tile", "Tiles01_COL_VAR1_6K.png"),
    ("woodfine01_a", "WoodFine001_ALBEDO_6K.png"),
    ("brick_col", "Bricks02_COL_VAR1_6K.png"),
    ("cliffde_col", "CliffDesert006_COL_VAR1_HIRES.png"),
    ("cliffde_nrm", "CliffDesert006_NRM_HIRES.png"),
    // LIBERO-Plus' released table writes this file name with the space.
    ("cobble01_disp", "Cobblestone01_DISP_6K copy.png"),
    ("marble_gloss", "Marble01_GLOSS_3K.png"),
    ("woodfine01_g", "WoodFine001_GLOSS_6K.png"),
    ("tile_r", "Tiles01_REFL_6K.png"),
];
const LIBEROS_FLOORS: usize = 12;

/// Wall styles and the names of their files; the first sixteen are LIBERO's.
const WALLS: [(&str, &str); 18] = [
    ("light_blue", "light_blue_wall.png"),
    ("dark_blue", "dark_blue_wall.png"),
    ("dark_gray_plaster", "dark_gray_plaster.png"),
    ("gray_plaster", "gray_plaster.png"),
    ("dark_green", "dark_green_plaster_wall.png"),
    ("light_gray_plaster", "light-gray-plaster.png"),
    ("ceramic", "ceramic.png"),
    ("white", "white_wall.png"),
    ("yellow_linen", "yellow_linen_wall_texture.png"),
    ("gray", "gray_wall.png"),
    ("stucco", "stucco_wall.png"),
    ("canvas", "canvas_sky_blue.png"),
    ("capriccio", "capriccio_sky.png"),
    ("gray_ceramic", "gray_ceramic_tile.png"),
    ("kona", "kona_gotham.png"),
    ("light_grey", "light_grey_plaster.png"),
    // LIBERO's cream-plaster.png is a different file.
    ("cream", "cream_plaster.png"),
    ("brick_disp", "Bricks02_DISP_6K.png"),
];
const LIBEROS_WALLS: usize = 16;

/// Prefixes of the textures whose scenes are directly in `scenes/`; the scenes of all other
/// textures are in a folder such as `scenes/kitchen250/`.
const ROOT_TEXTURES: [&str; 6] = ["bricks", "cliff", "cobble", "marble", "tiles", "woodfine"];

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "read problem class `{0}`: it does not have the form of LIBERO's or LIBERO-Plus' class names"
)]
pub struct ProblemError(String);

impl ProblemClass {
    /// Parses a class's name, as written in BDDL files. Textures and scenes that LIBERO-Plus does
    /// not have are accepted.
    pub fn parse(name: &str) -> Result<Self, ProblemError> {
        let lower = name.to_lowercase();
        let unknown = || ProblemError(name.to_owned());
        let (parent, prefix) = PARENTS
            .into_iter()
            .find(|(parent, _)| lower.starts_with(parent))
            .ok_or_else(unknown)?;
        let Some(rest) = name[parent.len()..].strip_prefix('_') else {
            let is_parent = lower.len() == parent.len();
            return is_parent.then(|| Self::from_parent(parent)).ok_or_else(unknown);
        };
        let class = match prefix {
            "floor" if !rest.starts_with("floor_light") => parse_floor(rest),
            _ => parse_scene(prefix, rest),
        };
        let class = class.ok_or_else(unknown)?;
        Ok(Self { parent, ..class })
    }

    fn from_parent(parent: &'static str) -> Self {
        Self { parent, scene: None, floor: None, wall: None }
    }

    pub fn assets(&self) -> Assets {
        let styles = [&self.floor, &self.wall];
        let has_only_liberos = styles.into_iter().flatten().all(|style| style.is_liberos);
        match &self.scene {
            Some(scene) if scene.starts_with("scenes/lights/") => Assets::Lights,
            Some(_) => Assets::Scenes,
            None if has_only_liberos => Assets::Libero,
            None => Assets::FloorTextures,
        }
    }
}

/// Parses `FloorSTYLE` or `Combined_FloorSTYLE_WallSTYLE`.
fn parse_floor(rest: &str) -> Option<ProblemClass> {
    let (floor, wall) = match strip(rest, "combined_floor") {
        Some(styles) => {
            let at = find(styles, "_wall")?;
            (&styles[..at], Some(&styles[at + "_wall".len()..]))
        }
        None => (strip(rest, "floor")?, None),
    };
    Some(ProblemClass {
        floor: Some(style(floor, &FLOORS, LIBEROS_FLOORS)),
        wall: wall.map(|wall| style(wall, &WALLS, LIBEROS_WALLS)),
        ..ProblemClass::from_parent("")
    })
}

/// Parses `PREFIX_light_sync_modified_N`, or `PREFIX_table_TEXTURE` with optional
/// `_bg_TEXTURE` or `_Wall_STYLE`.
fn parse_scene(prefix: &str, rest: &str) -> Option<ProblemClass> {
    let kind = strip(rest, prefix)?;
    let with_scene = |scene: String, wall| ProblemClass {
        scene: Some(scene),
        wall,
        ..ProblemClass::from_parent("")
    };
    if let Some(number) = strip(kind, "_light_sync_modified_") {
        let number: u16 = number.parse().ok()?;
        let scene = format!("scenes/lights/{prefix}_light_sync_modified_{number}.xml");
        return Some(with_scene(scene, None));
    }
    let textures = strip(kind, "_table_")?;
    if find(textures, "_bg_").is_some() {
        return Some(with_scene(format!("scenes/{prefix}xml/{rest}.xml"), None));
    }
    if let Some(at) = find(textures, "_wall_") {
        let wall = style(&textures[at + "_wall_".len()..], &WALLS, LIBEROS_WALLS);
        let scene = &rest[..rest.len() - (textures.len() - at)];
        return Some(with_scene(format!("scenes/{scene}.xml"), Some(wall)));
    }
    let lower = textures.to_lowercase();
    let folder = match ROOT_TEXTURES.iter().any(|prefix| lower.starts_with(prefix)) {
        true => String::new(),
        false => format!("{prefix}250/"),
    };
    Some(with_scene(format!("scenes/{folder}{rest}.xml"), None))
}

/// Returns the texture of a style; the first `liberos` known styles are LIBERO's.
fn style(name: &str, known: &[(&str, &str)], liberos: usize) -> Style {
    let key = name.to_lowercase();
    match known.iter().position(|(style, _)| *style == key) {
        Some(index) => Style { file: known[index].1.to_owned(), is_liberos: index < liberos },
        None => Style { file: format!("{name}.png"), is_liberos: false },
    }
}

/// Strips an ASCII prefix, ignoring case.
fn strip<'a>(text: &'a str, prefix: &str) -> Option<&'a str> {
    let head = text.get(..prefix.len())?;
    head.eq_ignore_ascii_case(prefix).then(|| &text[prefix.len()..])
}

/// Returns the index of an ASCII part, ignoring case.
fn find(text: &str, part: &str) -> Option<usize> {
    text.to_ascii_lowercase().find(part)
}
