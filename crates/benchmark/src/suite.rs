//! The four LIBERO suites that the protocol evaluates, and their forty tasks in the
//! benchmark's own order. Scenes and goals are in the tasks' BDDL files.

use std::fmt;
use std::str::FromStr;

use crate::names::{UnknownName, serde_as_text};

pub const TASKS_PER_SUITE: u8 = 10;
pub const INIT_STATES_PER_TASK: u16 = 50;

/// A task suite of LIBERO.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Suite {
    /// `libero_spatial`: one object, ten places.
    Spatial,
    /// `libero_object`: ten objects, one place.
    Object,
    /// `libero_goal`: one scene, ten goals.
    Goal,
    /// `libero_10`, the paper's Long: ten two-stage tasks.
    Long,
    /// The tasks of a suite file, by their position in the file. This is no suite of LIBERO, so
    /// that neither [`Self::ALL`] nor the parser includes it.
    Own,
    /// The tasks of other simulators, by their order in the manifest. Like [`Self::Own`] no suite
    /// of LIBERO.
    Simulated,
}

impl Suite {
    /// LIBERO's suites, in the reference's order.
    pub const ALL: [Self; 4] = [Self::Spatial, Self::Object, Self::Goal, Self::Long];

    /// Returns LIBERO's name: `libero_spatial`, …, `libero_10`; `own` for [`Self::Own`] and
    /// `simulated` for [`Self::Simulated`].
    pub const fn name(self) -> &'static str {
        match self {
            Self::Spatial => "libero_spatial",
            Self::Object => "libero_object",
            Self::Goal => "libero_goal",
            Self::Long => "libero_10",
            Self::Own => "own",
            Self::Simulated => "simulated",
        }
    }

    /// Returns the name in rollout ids: `spatial`, `object`, `goal`, `long`, `own`, `sim`.
    pub const fn short_name(self) -> &'static str {
        match self {
            Self::Spatial => "spatial",
            Self::Object => "object",
            Self::Goal => "goal",
            Self::Long => "long",
            Self::Own => "own",
            Self::Simulated => "sim",
        }
    }

    /// Returns the suite's tasks in the benchmark's order; none for [`Self::Own`] and
    /// [`Self::Simulated`], whose tasks only a suite file or a manifest lists.
    pub fn tasks(self) -> impl Iterator<Item = TaskRef> {
        let count = match self {
            Self::Own | Self::Simulated => 0,
            _ => TASKS_PER_SUITE,
        };
        (0..count).map(move |index| TaskRef { suite: self, index })
    }

    pub(crate) const fn ordinal(self) -> Option<usize> {
        match self {
            Self::Own | Self::Simulated => None,
            suite => Some(suite as usize),
        }
    }
}

impl fmt::Display for Suite {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Suite {
    type Err = UnknownName;

    /// Parses either name: `libero_10` and `long` are the same suite.
    fn from_str(text: &str) -> Result<Self, UnknownName> {
        Self::ALL
            .into_iter()
            .find(|suite| suite.name() == text || suite.short_name() == text)
            .ok_or_else(|| UnknownName::new("suite", text, &Self::ALL.map(Self::name)))
    }
}

serde_as_text!(Suite);

/// A task: a suite and an index in it. Displays as `libero_goal/3`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TaskRef {
    suite: Suite,
    index: u8,
}

impl TaskRef {
    pub fn new(suite: Suite, index: u32) -> Result<Self, UnknownName> {
        match u8::try_from(index) {
            Ok(index) if index < TASKS_PER_SUITE && suite.ordinal().is_some() => {
                Ok(Self { suite, index })
            }
            _ => Err(unknown_task(&format!("{suite}/{index}"), suite.name())),
        }
    }

    /// The index is the task's position in the suite file.
    pub const fn own(index: u8) -> Self {
        Self { suite: Suite::Own, index }
    }

    /// The index is the task's place among those of the manifest.
    pub const fn simulated(index: u8) -> Self {
        Self { suite: Suite::Simulated, index }
    }

    pub fn all() -> impl Iterator<Item = Self> {
        Suite::ALL.into_iter().flat_map(Suite::tasks)
    }

    pub const fn suite(self) -> Suite {
        self.suite
    }

    /// Returns the index in the suite, 0 to 9, in the benchmark's order, or the position in a suite
    /// file.
    pub const fn index(self) -> u8 {
        self.index
    }

    /// Returns the stem of the task's files: `NAME.bddl`, `NAME.pruned_init`; empty for a task of a
    /// suite file.
    pub fn name(self) -> &'static str {
        let names = self.suite.ordinal().map(|suite| TASK_NAMES[suite]);
        names.map_or("", |names| names[usize::from(self.index)])
    }

    /// Returns the canonical instruction, which LIBERO derives from the file's name; empty for a
    /// task of a suite file.
    pub fn instruction(self) -> String {
        instruction_of_name(self.name())
    }
}

/// Returns the instruction that LIBERO derives from the name of a task's files: its words, without
/// the scene prefix of names such as those in `libero_10`.
pub(crate) fn instruction_of_name(name: &str) -> String {
    let words = match name.split_once("_SCENE") {
        Some((_, rest)) => rest.split_once('_').map_or(rest, |(_, words)| words),
        None => name,
    };
    words.replace('_', " ")
}

impl fmt::Display for TaskRef {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.suite, self.index)
    }
}

impl FromStr for TaskRef {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        let (suite, index) = text.split_once('/').ok_or_else(|| unknown_task(text, "SUITE"))?;
        let suite: Suite = suite.parse()?;
        let index = index.parse().map_err(|_| unknown_task(text, suite.name()))?;
        Self::new(suite, index)
    }
}

serde_as_text!(TaskRef);

fn unknown_task(given: &str, suite: &str) -> UnknownName {
    let valid = format!("{suite}/0 to {suite}/9");
    UnknownName::new("task", given, &[&valid])
}

/// File stems of the tasks by suite, then by index in the suite.
///
/// Source: the task map and task order 0 of LIBERO's benchmark (hf-libero 0.1.4); the order is the
/// benchmark's, not the alphabet's.
const TASK_NAMES: [[&str; 10]; 4] = [
    [
        "pick_up_the_black_bowl_between_the_plate_and_the_ramekin_and_place_it_on_the_plate",
        "pick_up_the_black_bowl_next_to_the_ramekin_and_place_it_on_the_plate",
        "pick_up_the_black_bowl_from_table_center_and_place_it_on_the_plate",
        "pick_up_the_black_bowl_on_the_cookie_box_and_place_it_on_the_plate",
        "pick_up_the_black_bowl_in_the_top_drawer_of_the_wooden_cabinet_and_place_it_on_the_plate",
        "pick_up_the_black_bowl_on_the_ramekin_and_place_it_on_the_plate",
        "pick_up_the_black_bowl_next_to_the_cookie_box_and_place_it_on_the_plate",
        "pick_up_the_black_bowl_on_the_stove_and_place_it_on_the_plate",
        "pick_up_the_black_bowl_next_to_the_plate_and_place_it_on_the_plate",
        "pick_up_the_black_bowl_on_the_wooden_cabinet_and_place_it_on_the_plate",
    ],
    [
        "pick_up_the_alphabet_soup_and_place_it_in_the_basket",
        "pick_up_the_cream_cheese_and_place_it_in_the_basket",
        "pick_up_the_salad_dressing_and_place_it_in_the_basket",
        "pick_up_the_bbq_sauce_and_place_it_in_the_basket",
        "pick_up_the_ketchup_and_place_it_in_the_basket",
        "pick_up_the_tomato_sauce_and_place_it_in_the_basket",
        "pick_up_the_butter_and_place_it_in_the_basket",
        "pick_up_the_milk_and_place_it_in_the_basket",
        "pick_up_the_chocolate_pudding_and_place_it_in_the_basket",
        "pick_up_the_orange_juice_and_place_it_in_the_basket",
    ],
    [
        "open_the_middle_drawer_of_the_cabinet",
        "put_the_bowl_on_the_stove",
        "put_the_wine_bottle_on_top_of_the_cabinet",
        "open_the_top_drawer_and_put_the_bowl_inside",
        "put_the_bowl_on_top_of_the_cabinet",
        "push_the_plate_to_the_front_of_the_stove",
        "put_the_cream_cheese_in_the_bowl",
        "turn_on_the_stove",
        "put_the_bowl_on_the_plate",
        "put_the_wine_bottle_on_the_rack",
    ],
    [
        "LIVING_ROOM_SCENE2_put_both_the_alphabet_soup_and_the_tomato_sauce_in_the_basket",
        "LIVING_ROOM_SCENE2_put_both_the_cream_cheese_box_and_the_butter_in_the_basket",
        "KITCHEN_SCENE3_turn_on_the_stove_and_put_the_moka_pot_on_it",
        "KITCHEN_SCENE4_put_the_black_bowl_in_the_bottom_drawer_of_the_cabinet_and_close_it",
        "LIVING_ROOM_SCENE5_put_the_white_mug_on_the_left_plate_and_put_the_yellow_and_white_mug_on_the_right_plate",
        "STUDY_SCENE1_pick_up_the_book_and_place_it_in_the_back_compartment_of_the_caddy",
        "LIVING_ROOM_SCENE6_put_the_white_mug_on_the_plate_and_put_the_chocolate_pudding_to_the_right_of_the_plate",
        "LIVING_ROOM_SCENE1_put_both_the_alphabet_soup_and_the_cream_cheese_box_in_the_basket",
        "KITCHEN_SCENE8_put_both_moka_pots_on_the_stove",
        "KITCHEN_SCENE6_put_the_yellow_and_white_mug_in_the_microwave_and_close_it",
    ],
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forty_tasks_are_parsed_from_their_text() {
        let tasks: Vec<TaskRef> = TaskRef::all().collect();
        assert_eq!(tasks.len(), 40);
        for task in tasks {
            assert_eq!(task.to_string().parse(), Ok(task));
        }
        assert_eq!("long/3".parse::<TaskRef>(), "libero_10/3".parse());
    }

    #[test]
    fn instruction_is_the_file_name_without_its_scene() {
        let instruction = |task: &str| task.parse::<TaskRef>().expect("a task").instruction();
        assert_eq!(instruction("goal/7"), "turn on the stove");
        assert_eq!(instruction("libero_10/2"), "turn on the stove and put the moka pot on it");
        assert_eq!(
            instruction("libero_10/5"),
            "pick up the book and place it in the back compartment of the caddy"
        );
    }

    #[test]
    fn the_error_for_an_unknown_name_lists_the_valid_ones() {
        let error = |task: &str| task.parse::<TaskRef>().expect_err("no task").to_string();
        assert_eq!(
            error("libero_goat/3"),
            "read suite `libero_goat`: valid are libero_spatial, libero_object, \
             libero_goal, libero_10"
        );
        assert_eq!(
            error("libero_goal/10"),
            "read task `libero_goal/10`: valid are libero_goal/0 to libero_goal/9"
        );
        assert_eq!(error("libero_goal"), "read task `libero_goal`: valid are SUITE/0 to SUITE/9");
    }
}
