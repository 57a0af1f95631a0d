use super::*;
use crate::expert::kinematic_scene::KinematicScene;
use crate::expert::motion::servo;
use crate::expert::place::Relation;

const BASKET: &str = "basket_1_contain_region";

fn scene() -> KinematicScene {
    KinematicScene::new("in", &["can_1", BASKET])
        .object("can_1", [-0.1, -0.2, 0.038], [0.031, 0.031, 0.038])
        .object("basket_1", [0.0, 0.26, 0.07], [0.08, 0.085, 0.07])
        .region(BASKET, "basket_1", [0.0, 0.26, 0.067], [0.061, 0.061, 0.069])
}

fn can_into_basket() -> Transfer {
    let place = Place { relation: Relation::In, target: BASKET.to_owned(), slot: 0.0 };
    Transfer::new("can_1".to_owned(), place)
}

/// Runs the skill to its end and returns the names of the phases in the order in which
/// they were entered. `disturb` is called after each step, with the step's phase.
fn run(
    scene: &mut KinematicScene,
    mut disturb: impl FnMut(&mut KinematicScene, Phase),
) -> Vec<String> {
    let (mut transfer, mut motion) = (can_into_basket(), Motion::default());
    let mut phases: Vec<String> = Vec::new();
    for _ in 0..400 {
        let world = scene.world();
        motion.observe(&world);
        let Some(command) = transfer.step(&world, &motion).expect("a valid scene") else {
            return phases;
        };
        let shown = format!("{:?}", transfer.phase);
        let name = shown.split(['(', ' ']).next().unwrap_or_default().to_owned();
        if phases.last() != Some(&name) {
            phases.push(name);
        }
        scene.apply(servo(&world, &motion, &command));
        disturb(scene, transfer.phase);
    }
    panic!("the skill did not end; phases: {phases:?}");
}

const ALL_PHASES: [&str; 8] =
    ["Approach", "Descend", "Close", "Lift", "Carry", "Lower", "Release", "Retreat"];

fn in_basket(scene: &KinematicScene) -> bool {
    let world = scene.world();
    can_into_basket().place.holds(&world, world.entity("can_1").unwrap()).unwrap()
}

#[test]
fn a_can_goes_into_a_basket_phase_by_phase() {
    let mut scene = scene();
    assert_eq!(run(&mut scene, |_, _| ()), ALL_PHASES);
    assert!(in_basket(&scene));
}

#[test]
fn a_missed_grasp_is_detected_on_lifting_and_tried_again() {
    let mut scene = scene();
    scene.failing_grasps = 1;
    let phases = run(&mut scene, |_, _| ());
    let missed = ["Approach", "Descend", "Close", "Lift"];
    assert_eq!(phases, [&missed[..], &ALL_PHASES[..]].concat());
    assert!(in_basket(&scene));
}

#[test]
fn an_object_lost_on_the_way_is_picked_up_again() {
    let mut scene = scene();
    let mut lost = false;
    let phases = run(&mut scene, |scene, phase| {
        if matches!(phase, Phase::Carry(_)) && !lost && scene.state.grip_pos[1] > 0.0 {
            scene.knock_out_of_hand();
            lost = true;
        }
    });
    assert_eq!(phases, [&ALL_PHASES[..5], &ALL_PHASES[..]].concat());
    assert!(in_basket(&scene));
}

#[test]
fn each_attempt_takes_the_next_grasp() {
    let scene = scene();
    let world = scene.world();
    let can = world.entity("can_1").unwrap();
    let mut transfer = can_into_basket();
    let mut chosen = Vec::new();
    for failed_attempts in 0..2 {
        transfer.failed_attempts = failed_attempts;
        match transfer.choose(&world, can) {
            Ok(Next::Go(Phase::Approach(grip))) => chosen.push(grip.grasp),
            _ => panic!("no grasp chosen"),
        }
    }
    assert_ne!(chosen[0], chosen[1]);
}

/// The hand is at the best grasp of the can, but rotated by `turned` rad.
fn hand_at_grasp(turned: f64) -> KinematicScene {
    let mut scene = scene();
    let world = scene.world();
    let can = world.entity("can_1").unwrap();
    let purpose = can_into_basket().purpose(&world, can).unwrap();
    let grasp = grasp::nearest(&world, can, purpose, None, None).unwrap();
    let pos = can.centre + grasp.offset;
    let quat = Quat::turn(Vec3::UP, turned).after(pointing_down(grasp.closing));
    scene.state.grip_pos = [pos.x, pos.y, pos.z];
    scene.state.grip_quat_wxyz = [quat.w, quat.v.x, quat.v.y, quat.v.z];
    scene
}

/// The fingers had these openings, m.
fn motion_after(scene: &mut KinematicScene, openings: &[f64]) -> Motion {
    let mut motion = Motion::default();
    for opening in openings {
        scene.state.gripper_opening = *opening;
        motion.observe(&scene.world());
    }
    motion
}

fn resumed(earlier: Option<&Transfer>, scene: &KinematicScene, motion: &Motion) -> Transfer {
    let mut transfer = can_into_basket();
    let world = scene.world();
    transfer.resume(earlier, &world, motion).expect("a phase");
    transfer
}

#[test]
fn fingers_that_turn_the_object_go_on_closing() {
    let mut scene = hand_at_grasp(0.4);
    let motion = motion_after(&mut scene, &[0.04, 0.03, 0.02]);
    let phase = resumed(None, &scene, &motion).phase;
    assert!(matches!(phase, Phase::Close(_)), "{phase:?}");
    // The same hand with fingers that open leaves the grasp.
    let motion = motion_after(&mut scene, &[0.02, 0.03, 0.04]);
    let phase = resumed(None, &scene, &motion).phase;
    assert!(matches!(phase, Phase::Approach(_)), "{phase:?}");
}

#[test]
fn an_object_is_lifted_after_the_fingers_have_closed() {
    let mut scene = hand_at_grasp(0.0);
    let motion = motion_after(&mut scene, &[0.03, 0.02]);
    let closing = resumed(None, &scene, &motion);
    assert!(matches!(closing.phase, Phase::Close(_)), "{closing:?}");
    let motion = motion_after(&mut scene, &[0.02; 5]);
    let lifting = resumed(Some(&closing), &scene, &motion);
    assert!(matches!(lifting.phase, Phase::Lift(_)), "{lifting:?}");
    for position in [&mut scene.state.grip_pos, &mut scene.state.entities[0].pos] {
        position[2] += 2.0 * LIFT_M;
    }
    scene.state.entities[0].centre[2] += 2.0 * LIFT_M;
    let carrying = resumed(Some(&lifting), &scene, &motion);
    assert!(matches!(carrying.phase, Phase::Carry(_)), "{carrying:?}");
}

#[test]
fn a_hand_stopped_above_its_grasp_chooses_another_grasp() {
    let mut scene = hand_at_grasp(0.0);
    scene.state.grip_pos[2] += 2.0 * STOPPED_M;
    let (mut earlier, mut motion) = (None, Motion::default());
    let mut grasps = Vec::new();
    for _ in 0..=BLOCKED_STEPS.1 {
        motion.observe(&scene.world());
        let transfer = resumed(earlier.as_ref(), &scene, &motion);
        grasps.extend(transfer.grasp);
        earlier = Some(transfer);
    }
    let (last, before) = grasps.split_last().unwrap();
    assert!(before[..before.len() - 1].iter().all(|grasp| *grasp == before[0]));
    assert_ne!(*last, before[0]);
}

#[test]
fn an_object_stopped_before_its_covered_place_is_released_and_pushed_on() {
    const INSIDE: &str = "oven_1_inside";
    let mut transfer = Transfer::new(
        "mug_1".to_owned(),
        Place { relation: Relation::In, target: INSIDE.to_owned(), slot: 0.0 },
    );
    let mut scene = KinematicScene::new("in", &["mug_1", INSIDE])
        .object("mug_1", [0.0, 0.0, 0.05], [0.03, 0.03, 0.05])
        .fixture("oven_1", [0.0, 0.4, 0.1], [0.2, 0.1, 0.1])
        .region(INSIDE, "oven_1", [0.0, 0.4, 0.1], [0.12, 0.08, 0.08])
        .region("oven_1_top_side", "oven_1", [0.0, 0.4, 0.2], [0.15, 0.1, 0.001]);
    let distance_before_place = 0.014;
    let world = scene.world();
    let rest = transfer.place.spot(&world, world.entity("mug_1").unwrap());
    let rest = rest.unwrap().rest;
    let mug = &mut scene.state.entities[0];
    (mug.pos, mug.centre) = (
        [rest.x, rest.y - distance_before_place, rest.z],
        [rest.x, rest.y - distance_before_place, rest.z + 0.05],
    );
    scene.state.grip_pos = mug.centre;
    let motion = motion_after(&mut scene, &[0.02; 6]);
    let world = scene.world();
    transfer.resume(None, &world, &motion).expect("a phase");
    let Phase::Release { hand, .. } = transfer.phase else {
        panic!("{transfer:?}");
    };
    assert!((hand.pos.y - world.grip.y - distance_before_place).abs() < 1e-9, "{hand:?}");
    // Released, the object counts as placed, although it is not entirely inside.
    scene.state.grip_pos[1] -= 0.1;
    assert!(!transfer.is_placed(&scene.world()).unwrap());
    assert!(transfer.is_done(None, &scene.world(), &motion).unwrap());
    scene.state.grip_pos[1] += 0.1;
    // A hand that still moves continues to lower the object.
    let mut motion = motion;
    scene.state.grip_pos[1] += 0.002;
    motion.observe(&scene.world());
    transfer.resume(None, &scene.world(), &motion).expect("a phase");
    assert!(matches!(transfer.phase, Phase::Lower(_)), "{transfer:?}");
}

#[test]
fn fingers_that_release_an_object_open_fully() {
    let mut scene = scene();
    let world = scene.world();
    let spot = can_into_basket().place.spot(&world, world.entity("can_1").unwrap());
    let rest = spot.unwrap().rest;
    let can = &mut scene.state.entities[0];
    can.pos = [rest.x, rest.y, rest.z + can.half_extents[2]];
    can.centre = can.pos;
    scene.state.grip_pos = can.pos;
    let motion = motion_after(&mut scene, &[0.06, 0.067, 0.07]);
    let phase = resumed(None, &scene, &motion).phase;
    assert!(matches!(phase, Phase::Release { .. }), "{phase:?}");
}

#[test]
fn a_held_object_counts_as_placed_only_where_it_rests() {
    const SHELF: &str = "cabinet_1_top_side";
    let mut transfer = can_into_basket();
    transfer.place = Place { relation: Relation::On, target: SHELF.to_owned(), slot: 0.0 };
    let at_height = |bottom: f64, moved: f64| {
        let mut scene = KinematicScene::new("on", &["can_1", SHELF])
            .object("can_1", [0.0, 0.0, 0.2 + bottom + 0.038], [0.031, 0.031, 0.038])
            .region(SHELF, "cabinet_1", [0.0, 0.0, 0.2], [0.1, 0.1, 0.001]);
        scene.state.grip_pos = scene.state.entities[0].pos;
        let mut motion = motion_after(&mut scene, &[0.06; 4]);
        scene.state.grip_pos[2] -= moved;
        motion.observe(&scene.world());
        assert!(transfer.is_placed(&scene.world()).unwrap());
        transfer.is_done(None, &scene.world(), &motion).unwrap()
    };
    assert!(!at_height(0.05, 0.0), "above the shelf");
    assert!(!at_height(0.02, 0.006), "on the way down");
    assert!(at_height(0.02, 0.0), "stopped by the shelf");
}

#[test]
fn an_object_that_shifts_in_the_hand_stays_held() {
    let mut scene = hand_at_grasp(0.0);
    let motion = motion_after(&mut scene, &[0.02; 5]);
    let closed = resumed(None, &scene, &motion);
    assert!(matches!(closed.phase, Phase::Carry(_)), "{closed:?}");
    let motion = motion_after(&mut scene, &[0.02, 0.02, 0.02, 0.021]);
    let world = scene.world();
    assert!(!closed.holds(None, &world, &motion).unwrap());
    assert!(closed.holds(Some(&closed), &world, &motion).unwrap());
}
