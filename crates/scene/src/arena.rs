//! Workspaces of LIBERO's problem classes: arena models, positions of the robot, placement regions
//! and cameras. Constants of hf-libero 0.1.4, `envs/problems/*.py` and `envs/arenas/*.py`.

use std::borrow::Cow;

use benchmark::family::plus::{CameraPose, problem_class};

#[derive(Debug, Clone, PartialEq)]
pub struct Arena {
    /// Problem class as in BDDL files, lower case.
    pub problem: &'static str,
    /// Model file inside an asset pack.
    pub file: Cow<'static, str>,
    /// Texture file that replaces the texture of the model's floor.
    pub floor_texture: Cow<'static, str>,
    pub wall_texture: Cow<'static, str>,
    /// Category of the fixture that represents the workspace itself; no separate model is loaded
    /// for it.
    pub workspace_category: &'static str,
    /// Text that the names of zones (regions on the workspace) contain.
    pub zone_marker: &'static str,
    /// Body that the zones' sites are attached to.
    pub zone_body: &'static str,
    /// Offset that is added to a zone's centre to give its site's position in `zone_body`, m.
    pub zone_offset: [f64; 3],
    /// Origin of the regions' coordinates, world frame, m.
    pub workspace_offset: [f64; 3],
    /// Height of a placed fixture's underside over the workspace, m.
    pub fixture_z_offset: f64,
    pub table: Option<Table>,
    /// True if the whole radius of a sampled object must lie in its region, false if only the
    /// object's centre must.
    pub whole_object_in_region: bool,
    pub robot: RobotStand,
    /// Cameras to set or add, in order.
    pub cameras: &'static [Camera],
}

/// A rectangular table whose size the arena's model does not set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Table {
    /// Full extent, m.
    pub full_size: [f64; 3],
    /// Sliding, torsional, rolling friction.
    pub friction: [f64; 3],
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RobotStand {
    /// On robosuite's Rethink pedestal, which raises the base; x, y, z of the pedestal's foot, m.
    Pedestal([f64; 3]),
    /// Without a pedestal; x, y, z of the base, m.
    Ground([f64; 3]),
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    pub name: &'static str,
    /// Position, world frame, m.
    pub pos: [f64; 3],
    /// Orientation, world frame, w x y z.
    pub quat: [f64; 4],
}

impl Arena {
    pub fn camera(&self, name: &str) -> Option<CameraPose> {
        let camera = self.cameras.iter().find(|camera| camera.name == name)?;
        let Camera { pos, quat, .. } = *camera;
        Some(CameraPose { pos, quat })
    }
}

/// Returns the arena of a problem class of LIBERO or LIBERO-Plus. The classes of LIBERO-Plus are
/// LIBERO's with another model file or other textures.
pub fn arena(problem: &str) -> Option<Arena> {
    let libero_arena =
        |problem: &str| ARENAS.iter().find(|arena| arena.problem == problem).cloned();
    libero_arena(problem).or_else(|| {
        let class = problem_class(problem).ok()?;
        let arena = libero_arena(class.parent)?;
        Some(Arena {
            file: class.scene.map_or(arena.file, Cow::Owned),
            floor_texture: class.floor.map_or(arena.floor_texture, |style| style.file.into()),
            wall_texture: class.wall.map_or(arena.wall_texture, |style| style.file.into()),
            ..arena
        })
    })
}

/// Returns the names of LIBERO's problem classes; LIBERO-Plus' classes have arenas, too.
pub fn known_problems() -> Vec<&'static str> {
    ARENAS.iter().map(|arena| arena.problem).collect()
}

const fn camera(name: &'static str, pos: [f64; 3], quat: [f64; 4]) -> Camera {
    Camera { name, pos, quat }
}

const LOW_VIEW: [f64; 4] =
    [0.6182166934013367, 0.3432307541370392, 0.3432314395904541, 0.6182177066802979];
const HIGH_VIEW: [f64; 4] =
    [0.6380177736282349, 0.3048497438430786, 0.30484986305236816, 0.6380177736282349];
const FRONT_VIEW: [f64; 4] = [0.56, 0.43, 0.43, 0.56];
const GALLERY: Camera = camera(
    "galleryview",
    [2.844547668904445, 2.1279684793440667, 3.128616846013882],
    [0.42261379957199097, 0.23374411463737488, 0.41646939516067505, 0.7702690958976746],
);
const PAPER_VIEW: [f64; 4] = [0.513, 0.353, 0.443, 0.645];

const ARENAS: &[Arena] = &[
    Arena {
        problem: "libero_tabletop_manipulation",
        file: Cow::Borrowed("scenes/libero_tabletop_base_style.xml"),
        floor_texture: Cow::Borrowed("light-gray-floor-tile.png"),
        wall_texture: Cow::Borrowed("light-gray-plaster.png"),
        workspace_category: "table",
        zone_marker: "main_table",
        zone_body: "table",
        zone_offset: [0.0, 0.0, 0.02],
        workspace_offset: [0.0, 0.0, 0.90],
        fixture_z_offset: 0.01 - 0.05,
        table: Some(Table { full_size: [1.0, 1.2, 0.05], friction: [0.6, 0.005, 0.0001] }),
        whole_object_in_region: true,
        robot: RobotStand::Pedestal([-0.66, 0.0, 0.0]),
        cameras: &[
            camera("agentview", [0.6586131746834771, 0.0, 1.6103500240372423], HIGH_VIEW),
            camera("frontview", [1.0, 0.0, 1.48], FRONT_VIEW),
            GALLERY,
        ],
    },
    Arena {
        problem: "libero_kitchen_tabletop_manipulation",
        file: Cow::Borrowed("scenes/libero_kitchen_tabletop_base_style.xml"),
        floor_texture: Cow::Borrowed("gray_ceramic_tile.png"),
        wall_texture: Cow::Borrowed("yellow_linen_wall_texture.png"),
        workspace_category: "kitchen_table",
        zone_marker: "kitchen_table",
        zone_body: "table",
        zone_offset: [0.0, 0.0, 0.0],
        workspace_offset: [0.0, 0.0, 0.90],
        fixture_z_offset: 0.01 - 0.05,
        table: Some(Table { full_size: [1.0, 1.2, 0.05], friction: [1.0, 0.005, 0.0001] }),
        whole_object_in_region: false,
        robot: RobotStand::Pedestal([-0.66, 0.0, 0.0]),
        cameras: &[
            camera("agentview", [0.6586131746834771, 0.0, 1.6103500240372423], HIGH_VIEW),
            camera("frontview", [1.0, 0.0, 1.48], FRONT_VIEW),
            GALLERY,
            camera("paperview", [2.1, 0.535, 2.075], PAPER_VIEW),
        ],
    },
    Arena {
        problem: "libero_living_room_tabletop_manipulation",
        file: Cow::Borrowed("scenes/libero_living_room_tabletop_base_style.xml"),
        floor_texture: Cow::Borrowed("seamless_wood_planks_floor.png"),
        wall_texture: Cow::Borrowed("light-gray-plaster.png"),
        workspace_category: "living_room_table",
        zone_marker: "living_room_table",
        zone_body: "living_room_table",
        zone_offset: [0.0, 0.0, 0.41],
        workspace_offset: [0.0, 0.0, 0.41],
        fixture_z_offset: 0.01 - 0.024,
        table: None,
        whole_object_in_region: false,
        robot: RobotStand::Ground([-0.51, 0.0, 0.42]),
        cameras: &[
            camera("agentview", [0.6065773716836134, 0.0, 0.96], LOW_VIEW),
            camera("frontview", [1.5, 0.0, 0.9], FRONT_VIEW),
            GALLERY,
            camera("paperview", [2.1, 0.735, 1.875], PAPER_VIEW),
        ],
    },
    Arena {
        problem: "libero_study_tabletop_manipulation",
        file: Cow::Borrowed("scenes/libero_study_base_style.xml"),
        floor_texture: Cow::Borrowed("light-gray-floor-tile.png"),
        wall_texture: Cow::Borrowed("light-gray-plaster.png"),
        workspace_category: "study_table",
        zone_marker: "study_table",
        zone_body: "study_table",
        zone_offset: [-0.2, 0.0, 0.867],
        workspace_offset: [-0.2, 0.0, 0.867],
        fixture_z_offset: 0.01 - 0.05,
        table: None,
        whole_object_in_region: false,
        robot: RobotStand::Pedestal([-0.75, 0.0, 0.0]),
        cameras: &[
            camera("agentview", [0.4586131746834771, 0.0, 1.6103500240372423], HIGH_VIEW),
            camera("frontview", [1.0, 0.0, 1.48], FRONT_VIEW),
            GALLERY,
            camera("paperview", [2.1, 0.535, 2.075], PAPER_VIEW),
        ],
    },
    Arena {
        problem: "libero_floor_manipulation",
        file: Cow::Borrowed("scenes/libero_floor_base_style.xml"),
        floor_texture: Cow::Borrowed("light-gray-floor-tile.png"),
        wall_texture: Cow::Borrowed("light-gray-plaster.png"),
        workspace_category: "floor",
        zone_marker: "floor",
        zone_body: "floor",
        zone_offset: [0.0, 0.0, 0.02],
        workspace_offset: [0.0, 0.0, -0.035],
        fixture_z_offset: -0.025,
        table: None,
        whole_object_in_region: true,
        robot: RobotStand::Ground([-0.6, 0.0, 0.0]),
        cameras: &[
            camera("agentview", [0.8965773716836134, 5.216182733499864e-7, 0.65], LOW_VIEW),
            camera("frontview", [1.0, 0.0, 0.65], FRONT_VIEW),
            GALLERY,
        ],
    },
    Arena {
        problem: "libero_coffee_table_manipulation",
        file: Cow::Borrowed("scenes/libero_coffee_table_base_style.xml"),
        floor_texture: Cow::Borrowed("seamless_wood_planks_floor.png"),
        wall_texture: Cow::Borrowed("light-gray-plaster.png"),
        workspace_category: "coffee_table",
        zone_marker: "coffee_table",
        zone_body: "coffee_table",
        zone_offset: [0.0, 0.0, 0.02],
        workspace_offset: [0.0, 0.0, 0.41],
        fixture_z_offset: 0.01 - 0.024,
        table: None,
        whole_object_in_region: true,
        robot: RobotStand::Ground([-0.51, 0.0, 0.41]),
        cameras: &[
            camera("agentview", [1.5, 0.0, 0.9], FRONT_VIEW),
            GALLERY,
            camera("canonical_agentview", [0.5386131746834771, 0.0, 0.7903500240372423], HIGH_VIEW),
        ],
    },
];
