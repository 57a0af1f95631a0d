//! Memory, threads and open files over many short rollouts in one process. There are more tasks
//! than cached scenes, so that scenes and their textures are constantly created and dropped.

use benchmark::presets::apply_preset;
use benchmark::{
    Axis, Condition, Level, ManifestRow, Perturbation, Realisation, RolloutId, TaskRef,
};
use scene::Sources;
use sim::{CameraRequest, ObservationRequest, Renderer, Simulator, SimulatorConfig};
use tests::files::open_pack;
use worker::open_loop::smooth_action;

/// Rounds over the tasks: the first five are the warm-up, the last five are compared with it.
const ROUNDS: u16 = 15;
const COMPARED: usize = 5;
/// Relative growth that does not count as a leak.
const ALLOWED_GROWTH: f64 = 0.05;

#[test]
fn memory_stays_level_over_sixty_rollouts_of_four_tasks() {
    let tasks: Vec<TaskRef> = TaskRef::all().step_by(TaskRef::all().count() / 4).collect();
    let sources = Sources::open(&Sources::default_dir()).unwrap();
    let mut simulator = Simulator::new(SimulatorConfig {
        pack: open_pack("primitives", &sources, tasks.iter().copied()).unwrap(),
        sources,
        renderer: Renderer::default(),
        cached_scenes: 3,
    });
    // Memory is measured at the ends of rounds, when the cache always holds the same scenes.
    let mut used = Vec::new();
    for round in 0..ROUNDS {
        tasks.iter().for_each(|task| roll_out(&mut simulator, *task, round % 10));
        used.push(Usage::now());
    }
    let (warm_up, last) = (&used[..COMPARED], &used[used.len() - COMPARED..]);
    // A maximum would grow with the number of rounds even without a leak, because allocators
    // return pages at arbitrary times.
    let median = |used: &[Usage]| {
        let mut values: Vec<f64> = used.iter().map(|usage| usage.resident_kib).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let growth = median(last) / median(warm_up) - 1.0;
    assert!(growth <= ALLOWED_GROWTH, "resident memory grew by {:.1} %", growth * 100.0);
    let counts = |used: &[Usage]| used.last().map(|usage| (usage.threads, usage.open_files));
    assert_eq!(counts(warm_up), counts(last), "threads and open files");
}

/// Runs one short rollout with all metric axes perturbed (all but language), as in a campaign.
fn roll_out(simulator: &mut Simulator, task: TaskRef, config: u16) {
    let mut perturbation = Perturbation::default();
    for axis in Axis::METRIC {
        apply_preset(&mut perturbation, axis, Level::L2, config);
    }
    let init_id = task.eval_init_ids()[usize::from(config)];
    let id = RolloutId::perturbed(task, Condition::Simultaneous, Level::L2, config).unwrap();
    let row = ManifestRow::new(id, config, init_id, perturbation);
    let mut episode = simulator.begin(&row, Realisation::Matched).unwrap();
    episode.settle().unwrap();
    for step in 0..20 {
        episode.step(&smooth_action(step)).unwrap();
    }
    let camera = CameraRequest { name: "agentview".to_owned(), width: 64, height: 64 };
    let request = ObservationRequest { cameras: vec![camera], privileged: true };
    episode.observe(&request).unwrap();
}

struct Usage {
    resident_kib: f64,
    threads: f64,
    open_files: usize,
}

impl Usage {
    fn now() -> Self {
        let status = std::fs::read_to_string("/proc/self/status").unwrap();
        let field = |name: &str| {
            let value = status.lines().find_map(|line| line.strip_prefix(name)).unwrap();
            value.split_whitespace().next().unwrap().parse().unwrap()
        };
        Self {
            resident_kib: field("VmRSS:"),
            threads: field("Threads:"),
            open_files: std::fs::read_dir("/proc/self/fd").unwrap().count(),
        }
    }
}
