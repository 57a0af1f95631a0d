//! Compares resets without an initial state with the placements and random draws of the original
//! LIBERO.

mod draws;
mod files;
mod recorded;

use benchmark::numpy::LegacyRng;
use scene::{Scene, SceneError};
use sim::{Environment, Reset, SimError};

use files::{compile, crowded, packs};

/// Number of times that LIBERO has loaded its model: at construction, and in one hard reset.
const LOADED_TWICE: u32 = 2;

#[test]
fn loading_a_state_after_a_reset_restores_the_campaign_fixtures() {
    let mut environment = compile(&crowded(), &packs()[0]).unwrap();
    let poses = |environment: &Environment| environment.model().body_pos().to_vec();
    let mut state = vec![0.0];
    state.extend(environment.data().qpos(environment.model()));
    state.extend(environment.data().qvel(environment.model()));
    environment.load(&state);
    let campaign = poses(&environment);

    let mut rng = LegacyRng::seed(1);
    environment.reset(&mut rng, Reset::Hard, LOADED_TWICE).unwrap();
    assert_ne!(poses(&environment), campaign, "the reset places fixtures");
    environment.load(&state);
    assert_eq!(poses(&environment), campaign);
}

/// MuJoCo's warnings are stored per thread, not per environment.
#[test]
fn a_diverging_environment_does_not_stop_other_environments_on_its_thread() {
    let pack = &packs()[0];
    let [mut first, mut second] = [(); 2].map(|()| compile(&crowded(), pack).unwrap());
    for joints in [1..8, 1..3, 7..8] {
        let mut state = vec![0.0];
        state.extend(first.data().qpos(first.model()));
        state.extend(first.data().qvel(first.model()));
        state[joints].fill(1e9);
        first.load(&state);
        assert!(first.step(&[0.0; 7]).is_err());
        second.step(&[0.0; 7]).expect("the second environment is stable");
    }
}

#[test]
fn a_hard_reset_removes_perturbations_and_a_soft_reset_keeps_them() {
    let mut environment = compile(&crowded(), &packs()[0]).unwrap();
    let nominal_diffuse = environment.model().light_diffuse().to_vec();
    let mut rng = LegacyRng::seed(2);
    environment.model_mut().light_diffuse_mut().fill(0.1);
    environment.reset(&mut rng, Reset::Soft, LOADED_TWICE).unwrap();
    assert!(environment.model().light_diffuse().iter().all(|c| *c == 0.1));
    environment.reset(&mut rng, Reset::Hard, LOADED_TWICE).unwrap();
    assert_eq!(environment.model().light_diffuse(), nominal_diffuse);
}

#[test]
fn a_reset_updates_the_observation() {
    let mut environment = compile(&crowded(), &packs()[0]).unwrap();
    let mut rng = LegacyRng::seed(3);
    environment.reset(&mut rng, Reset::Hard, LOADED_TWICE).unwrap();
    let first = environment.robot_state();
    for _ in 0..3 {
        environment.step(&[0.5, 0.5, -0.5, 0.1, 0.0, 0.0, 1.0]).unwrap();
    }
    assert_ne!(environment.robot_state(), first);
    assert_eq!(environment.control_steps(), 3);
    environment.reset(&mut rng, Reset::Soft, LOADED_TWICE).unwrap();
    assert_eq!(environment.robot_state(), first);
    assert_eq!(environment.control_steps(), 0);
    assert_eq!(environment.data().time_secs(), 0.0);
}

#[test]
fn a_scene_without_room_is_refused_with_the_object_named() {
    let text = crowded().replace("(0.0 -0.301 0.06 -0.3)", "(0.0 -0.301 0.001 -0.3)");
    let Err(SimError::Scene(SceneError::NoRoom { object, region, .. })) =
        compile(&text, &packs()[0]).map(drop)
    else {
        panic!("the scene is composed although a bowl has no room");
    };
    assert_eq!(object, "akita_black_bowl_2");
    assert_eq!(region, "kitchen_table_narrow_region");
}

#[test]
fn an_inconsistent_initial_state_is_refused_with_the_statement() {
    let cases = [
        (
            "(Open white_cabinet_1_bottom_region)",
            "(On butter_1 kitchen_table_basket_region)",
            "(on butter_1 ketchup_1), but `butter_1` is already placed",
        ),
        (
            "(On basket_1 kitchen_table_basket_region)",
            "",
            "(on cream_cheese_1 basket_1_contain_region), but `basket_1` is not placed",
        ),
        (
            "(Open white_cabinet_1_bottom_region)",
            "(TurnOn white_cabinet_1_bottom_region)",
            "(turnon white_cabinet_1_bottom_region), but `white_cabinet_1_bottom_region` does \
             not support `turnon`",
        ),
        (
            "(On white_cabinet_1 kitchen_table_cabinet_region)",
            "(On white_cabinet_1 ketchup_1)",
            "(on white_cabinet_1 ketchup_1), but `white_cabinet_1` is a fixture",
        ),
        (
            "(On butter_1 ketchup_1)",
            "(On spoon_1 ketchup_1)",
            "(on spoon_1 ketchup_1), but `spoon_1` is not declared",
        ),
    ];
    for (from, to, expected) in cases {
        let text = crowded().replace(from, to);
        let error = compile(&text, &packs()[0]).map(drop).unwrap_err();
        let message = error.to_string();
        assert!(message.contains(expected), "{to}: {message}");
    }
}

/// Returns the names of the fixtures' bodies in the order in which the samplers draw.
fn fixtures(scene: &Scene) -> Vec<&str> {
    let bodies = scene.samplers.poses().iter();
    bodies
        .filter_map(|sampler| match &sampler.target {
            scene::placement::PoseTarget::Body(body) => Some(body.as_str()),
            scene::placement::PoseTarget::FreeJoint(_) => None,
        })
        .collect()
}
