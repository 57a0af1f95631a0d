//! What LIBERO knows about each category of object and fixture: its model
//! file, how many rotations its sampler draws, and when it counts as open,
//! closed, on or off. Facts of hf-libero 0.1.4, `envs/objects/*.py`.

/// A category of objects or fixtures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Category {
    /// As BDDL files write it.
    pub name: &'static str,
    /// Model file inside an asset pack.
    pub file: &'static str,
    /// Random numbers drawn for one orientation of a movable object.
    pub rotation_draws: u32,
    /// Joint thresholds of articulated categories.
    pub articulation: Articulation,
}

/// When a joint position `q` (m or rad) counts as open, closed, on or off.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Articulation {
    /// Nothing to open or turn on.
    None,
    /// Drawers and doors.
    OpenClose {
        /// Open beyond this.
        open: Threshold,
        /// Closed beyond this.
        close: Threshold,
    },
    /// A stove: on at `q >= on`, off at `q < off`.
    OnOff {
        /// rad.
        on: f64,
        /// rad.
        off: f64,
    },
}

/// One side of a joint's range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Threshold {
    /// `q` strictly above.
    Above(f64),
    /// `q` strictly below.
    Below(f64),
}

impl Threshold {
    /// Whether `q` lies on this side.
    pub fn holds(self, q: f64) -> bool {
        match self {
            Self::Above(limit) => q > limit,
            Self::Below(limit) => q < limit,
        }
    }
}

/// Looks a category up, ignoring case.
pub fn category(name: &str) -> Option<&'static Category> {
    CATEGORIES
        .iter()
        .find(|category| category.name.eq_ignore_ascii_case(name))
}

/// How many categories there are.
pub fn category_count() -> usize {
    CATEGORIES.len()
}

const fn rigid(name: &'static str, file: &'static str) -> Category {
    Category {
        name,
        file,
        rotation_draws: 1,
        articulation: Articulation::None,
    }
}

/// Categories whose sampler draws a rotation about x and one about z.
const fn twice_rotated(name: &'static str, file: &'static str) -> Category {
    Category {
        name,
        file,
        rotation_draws: 2,
        articulation: Articulation::None,
    }
}

const fn articulated(
    name: &'static str,
    file: &'static str,
    articulation: Articulation,
) -> Category {
    Category {
        name,
        file,
        rotation_draws: 1,
        articulation,
    }
}

const CABINET: Articulation = Articulation::OpenClose {
    open: Threshold::Below(-0.14),
    close: Threshold::Above(0.0),
};

const CATEGORIES: &[Category] = &[
    rigid(
        "akita_black_bowl",
        "stable_scanned_objects/akita_black_bowl/akita_black_bowl.xml",
    ),
    rigid(
        "alphabet_soup",
        "stable_hope_objects/alphabet_soup/alphabet_soup.xml",
    ),
    rigid("basin_faucet", "articulated_objects/basin_faucet.xml"),
    rigid("basket", "stable_scanned_objects/basket/basket.xml"),
    rigid("bbq_sauce", "stable_hope_objects/bbq_sauce/bbq_sauce.xml"),
    rigid("black_book", "turbosquid_objects/black_book/black_book.xml"),
    rigid(
        "bowl_drainer",
        "turbosquid_objects/bowl_drainer/bowl_drainer.xml",
    ),
    rigid("butter", "stable_hope_objects/butter/butter.xml"),
    rigid(
        "chefmate_8_frypan",
        "stable_scanned_objects/chefmate_8_frypan/chefmate_8_frypan.xml",
    ),
    rigid("cherries", "stable_hope_objects/cherries/cherries.xml"),
    rigid(
        "chocolate_pudding",
        "stable_hope_objects/chocolate_pudding/chocolate_pudding.xml",
    ),
    rigid("cookies", "stable_hope_objects/cookies/cookies.xml"),
    rigid("corn", "stable_hope_objects/corn/corn.xml"),
    rigid(
        "cream_cheese",
        "stable_hope_objects/cream_cheese/cream_cheese.xml",
    ),
    rigid("desk_caddy", "turbosquid_objects/desk_caddy/desk_caddy.xml"),
    rigid(
        "dining_set_group",
        "turbosquid_objects/dining_set_group/dining_set_group.xml",
    ),
    rigid("faucet", "articulated_objects/faucet.xml"),
    articulated(
        "flat_stove",
        "articulated_objects/flat_stove.xml",
        Articulation::OnOff { on: 0.5, off: 0.0 },
    ),
    rigid(
        "glazed_rim_porcelain_ramekin",
        "stable_scanned_objects/glazed_rim_porcelain_ramekin/glazed_rim_porcelain_ramekin.xml",
    ),
    twice_rotated("ketchup", "stable_hope_objects/ketchup/ketchup.xml"),
    twice_rotated(
        "macaroni_and_cheese",
        "stable_hope_objects/macaroni_and_cheese/macaroni_and_cheese.xml",
    ),
    twice_rotated("mayo", "stable_hope_objects/mayo/mayo.xml"),
    articulated(
        "microwave",
        "articulated_objects/microwave.xml",
        Articulation::OpenClose {
            open: Threshold::Below(-1.3),
            close: Threshold::Above(-0.005),
        },
    ),
    twice_rotated("milk", "stable_hope_objects/milk/milk.xml"),
    rigid("moka_pot", "turbosquid_objects/moka_pot/moka_pot.xml"),
    twice_rotated(
        "new_salad_dressing",
        "stable_hope_objects/new_salad_dressing/new_salad_dressing.xml",
    ),
    twice_rotated(
        "orange_juice",
        "stable_hope_objects/orange_juice/orange_juice.xml",
    ),
    rigid("plate", "stable_scanned_objects/plate/plate.xml"),
    rigid("popcorn", "stable_hope_objects/popcorn/popcorn.xml"),
    rigid(
        "porcelain_mug",
        "turbosquid_objects/porcelain_mug/porcelain_mug.xml",
    ),
    rigid("rack", "stable_scanned_objects/simple_rack/simple_rack.xml"),
    rigid(
        "red_coffee_mug",
        "turbosquid_objects/red_coffee_mug/red_coffee_mug.xml",
    ),
    twice_rotated(
        "salad_dressing",
        "stable_hope_objects/salad_dressing/salad_dressing.xml",
    ),
    articulated(
        "short_cabinet",
        "articulated_objects/short_cabinet.xml",
        Articulation::OpenClose {
            open: Threshold::Above(0.10),
            close: Threshold::Below(0.0),
        },
    ),
    articulated(
        "short_fridge",
        "articulated_objects/short_fridge.xml",
        Articulation::OpenClose {
            open: Threshold::Above(2.0),
            close: Threshold::Below(0.0),
        },
    ),
    rigid("slide_cabinet", "articulated_objects/slide_cabinet.xml"),
    rigid(
        "tomato_sauce",
        "stable_hope_objects/tomato_sauce/tomato_sauce.xml",
    ),
    rigid(
        "white_bowl",
        "stable_scanned_objects/white_bowl/white_bowl.xml",
    ),
    articulated(
        "white_cabinet",
        "articulated_objects/white_cabinet.xml",
        CABINET,
    ),
    rigid(
        "white_storage_box",
        "turbosquid_objects/white_storage_box/white_storage_box.xml",
    ),
    rigid(
        "white_yellow_mug",
        "turbosquid_objects/white_yellow_mug/white_yellow_mug.xml",
    ),
    rigid("window", "articulated_objects/window.xml"),
    rigid(
        "wine_bottle",
        "turbosquid_objects/wine_bottle/wine_bottle.xml",
    ),
    rigid("wine_rack", "turbosquid_objects/wine_rack/wine_rack.xml"),
    articulated(
        "wooden_cabinet",
        "articulated_objects/wooden_cabinet.xml",
        CABINET,
    ),
    rigid(
        "wooden_shelf",
        "turbosquid_objects/wooden_shelf/wooden_shelf.xml",
    ),
    rigid(
        "wooden_tray",
        "turbosquid_objects/wooden_tray/wooden_tray.xml",
    ),
    rigid(
        "wooden_two_layer_shelf",
        "turbosquid_objects/wooden_two_layer_shelf/wooden_two_layer_shelf.xml",
    ),
    rigid(
        "yellow_book",
        "turbosquid_objects/yellow_book/yellow_book.xml",
    ),
];
