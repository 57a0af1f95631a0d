//! Comparison of one case.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use benchmark::family::plus::{Variant, entry};
use benchmark::family::pro::ProSuite;
use benchmark::family::{Case, Subject};
use benchmark::numpy::LegacyRng;
use benchmark::{Benchmark, ManifestRow, Realisation, Suite, TaskRef};
use proto::checks::CAMERAS;
use scene::{AssetPack, Sources, TaskFiles};
use sha2::{Digest, Sha256};
use sim::{
    CameraRequest, Environment, ObjectKind, ObservationRequest, Renderer, Reset, Simulator,
    SimulatorConfig, Start, VariantStart,
};
use worker::variants::Prepared;

use super::recording::Recording;
use crate::fidelity::{FrameFindings, RendererRelation, read_upright};

/// Largest permitted difference of any coordinate of a state or a camera.
pub const TOLERANCE: f64 = 1e-9;
/// Number of times that the original has loaded its model after its construction and one reset.
pub const MODEL_LOADS: u32 = 2;
/// Side of the recorded pictures, pixels. Those with fog have 256, but fog draws equally many
/// random numbers for any size.
const SIDE: usize = 128;
/// Pictures that the original draws and corrupts: one at the reset, and one at each of ten waits.
const PICTURES: usize = 11;

/// Differences from the original in one case.
#[derive(Debug, Clone, Default)]
pub struct Findings {
    /// Dimension of LIBERO-Plus, last word of LIBERO-PRO's suite, or `sentences` for LIBERO-Para.
    pub group: String,
    /// Largest difference of any coordinate of a state.
    pub states: f64,
    /// Largest difference of the compiled pose of `agentview`; `None` if it was not recorded.
    pub camera: Option<f64>,
    /// True if the generator's next number is the recorded one; `None` if it was not recorded.
    pub draw: Option<bool>,
    /// True if prompt and sentence equal the recorded ones; `None` if no prompt was recorded or the
    /// file with the sentence is missing.
    pub prompt: Option<bool>,
    /// `None` if there is no recorded picture.
    pub frames: Option<FrameFindings>,
}

impl Findings {
    pub fn violations(&self) -> Vec<String> {
        let mut found = Vec::new();
        let differences = [("states", Some(self.states)), ("the camera", self.camera)];
        for (what, difference) in differences {
            if let Some(difference) = difference.filter(|difference| *difference > TOLERANCE) {
                found.push(format!("{what}: {difference:e} apart, more than {TOLERANCE:e}"));
            }
        }
        let equal = [("prompts", self.prompt), ("next numbers", self.draw)];
        for (what, _) in equal.iter().filter(|(_, equal)| *equal == Some(false)) {
            found.push(format!("{what} differ"));
        }
        let limits = RendererRelation::AnotherRenderer.limits();
        let frames = self.frames.as_ref();
        found.extend(frames.map_or_else(Vec::new, |frames| frames.violations(&limits)));
        found
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Skipped(pub String);

pub struct Comparison {
    sources: Sources,
    pack: AssetPack,
    /// LIBERO-PRO's assets; `None` if no folder of them is named.
    pro_pack: Option<AssetPack>,
    para: Option<PathBuf>,
    /// Pictures in the look of `pack`.
    pictures: PathBuf,
    simulators: BTreeMap<PathBuf, Simulator>,
}

struct Run {
    group: String,
    files: TaskFiles,
    row: ManifestRow,
    start: VariantStart,
    /// `None` if the file with the sentence is missing.
    prompts: Option<Prompts>,
}

struct Prompts {
    prompt: String,
    sentence: String,
}

impl Comparison {
    /// Prepares comparisons in the look of `pack`, LIBERO's assets: with it, with those that
    /// `ROLLOUT_PRO_ASSETS` names, and with the checkout of LIBERO-Para that `ROLLOUT_PARA` names.
    /// The folder of pictures has a folder for each look.
    pub fn new(sources: Sources, pack: AssetPack, pictures: &Path) -> Result<Self> {
        let pro_pack = std::env::var("ROLLOUT_PRO_ASSETS").ok();
        let pro_pack = pro_pack.map(|dir| AssetPack::open_whole(dir.as_ref())).transpose()?;
        let look = pack.look();
        Ok(Self {
            sources,
            pack,
            pro_pack: pro_pack.map(|pack| pack.with_look(look)),
            para: std::env::var_os("ROLLOUT_PARA").map(PathBuf::from),
            pictures: pictures.join(look.name()),
            simulators: BTreeMap::new(),
        })
    }

    /// Returns true if there are pictures of a case in the look.
    pub fn has_pictures(&self, benchmark: Benchmark, recording: &Recording) -> bool {
        let files = CAMERAS.map(|camera| picture(&self.pictures, benchmark, recording, camera));
        files.into_iter().flatten().any(|file| file.is_file())
    }

    /// Compares a case. Returns [`Skipped`] if its files are missing, or its variant is not one of
    /// the benchmark's.
    pub fn compare(
        &mut self,
        benchmark: Benchmark,
        recording: &Recording,
    ) -> Result<Result<Findings, Skipped>> {
        let run = self.run(benchmark, recording);
        let run = match run.with_context(|| recording.name.clone())? {
            Ok(run) => run,
            Err(skipped) => return Ok(Err(skipped)),
        };
        let pack = match AssetPack::files_of_tasks(std::slice::from_ref(&run.files)) {
            Ok(_) => {
                self.pack.provide_with_bar(std::slice::from_ref(&run.files))?;
                self.pack.clone()
            }
            Err(_) => match &self.pro_pack {
                Some(pack) => pack.clone(),
                None => {
                    let lack = "ROLLOUT_PRO_ASSETS names no folder of assets";
                    return Ok(Err(Skipped(lack.to_owned())));
                }
            },
        };
        let place = pack.dir().to_owned();
        let sources = self.sources.clone();
        let simulator = self.simulators.entry(place).or_insert_with(|| {
            Simulator::new(SimulatorConfig {
                sources,
                pack,
                renderer: Renderer::Software,
                cached_scenes: 1,
            })
        });
        let found = findings(benchmark, recording, run, simulator, &self.pictures);
        found.map(Ok).with_context(|| recording.name.clone())
    }

    fn run(&self, benchmark: Benchmark, recording: &Recording) -> Result<Result<Run, Skipped>> {
        let name = &recording.name;
        let (suite, rest) = name.split_once('/').unwrap_or(("", name));
        let (subject, protocol) = match benchmark {
            Benchmark::Plus => {
                let variant: Variant = rest.parse()?;
                // `states.txt` also has variants that only the released code accepts.
                let Some(entry) = entry(&variant) else {
                    let lack = "not one of the benchmark's 10,030 variants";
                    return Ok(Err(Skipped(lack.to_owned())));
                };
                (Subject::Plus(entry), "plus-openpi")
            }
            Benchmark::Pro => (Subject::Pro(suite.parse()?), "pro-openpi"),
            Benchmark::Para => (Subject::Unperturbed, "plus-openpi"),
        };
        let task = match subject {
            Subject::Plus(entry) => entry.variant.task,
            Subject::Pro(suite) => task_of(suite, rest)?,
            _ => task_of_sentence(name)?,
        };
        let case = Case { subject, task, trial: 0 };
        let protocol = protocol.parse()?;
        let row = case.row(&protocol);
        let own = row.own.as_deref().context("every case has a task")?;
        let files = TaskFiles::with_prompt(&self.sources, own);
        for file in [&files.bddl, &files.init] {
            if !file.is_file() {
                return Ok(Err(Skipped(format!("there is no {}", file.display()))));
            }
        }
        let Prepared { mut files, start, row } = Prepared::new(&row, own, &self.sources)?;
        let group = match subject {
            Subject::Plus(entry) => entry.dimension().to_string(),
            Subject::Pro(_) => suite.rsplit('_').next().unwrap_or_default().to_owned(),
            _ => "sentences".to_owned(),
        };
        let prompts = match (benchmark, &self.para) {
            (Benchmark::Para, None) => None,
            (Benchmark::Para, Some(checkout)) => {
                let folder = checkout.join("libero/libero");
                files.bddl = folder.join(format!("bddl_files/libero_para/{name}.bddl"));
                let number = number_of_task(name)?;
                files.init =
                    folder.join(format!("init_files/libero_para/eval{number}.pruned_init"));
                // LIBERO-Para's scripts keep the sentence's capitals in the prompt; parsers of BDDL
                // convert them to lower case.
                Some(Prompts { prompt: files.sentence()?, sentence: files.problem()?.language })
            }
            _ => Some(Prompts {
                prompt: row.instruction.clone(),
                sentence: files.problem()?.language,
            }),
        };
        Ok(Ok(Run { group, files, row, start, prompts }))
    }
}

fn findings(
    benchmark: Benchmark,
    recording: &Recording,
    run: Run,
    simulator: &mut Simulator,
    pictures: &Path,
) -> Result<Findings> {
    let mut findings = Findings {
        group: run.group,
        prompt: run.prompts.and_then(|prompts| prompts.equal(recording)),
        ..Findings::default()
    };
    let numbers = |kind: &str| recording.numbers.get(kind);
    if let Some(expected) = numbers("reset") {
        let row = ManifestRow { settle_steps: 0, ..run.row.clone() };
        let start = VariantStart { start: Start::Reset, ..run.start.clone() };
        let mut episode =
            simulator.begin_variant(run.files.clone(), &row, Realisation::Matched, &start)?;
        let found = episode.environment().state();
        findings.states = difference(&found, expected)?;
    }
    let mut episode =
        simulator.begin_variant(run.files.clone(), &run.row, Realisation::Matched, &run.start)?;
    episode.settle()?;
    let expected = numbers("official").context("the state after the waits is missing")?;
    let found = episode.environment().state();
    findings.states = findings.states.max(difference(&found, expected)?);
    if let Some(expected) = numbers("camera") {
        findings.camera = Some(difference(&camera(episode.environment())?, expected)?);
    }
    for name in CAMERAS {
        let path = picture(pictures, benchmark, recording, name);
        let Some(path) = path.filter(|path| path.is_file()) else {
            continue;
        };
        let expected = read_upright(&path)?;
        let (width, height) = expected.dimensions();
        let request = ObservationRequest {
            cameras: vec![CameraRequest { name: name.to_owned(), width, height }],
            privileged: false,
        };
        let frame = episode.observe(&request)?.frames.swap_remove(0);
        let frames = findings.frames.get_or_insert_default();
        let place = path.file_stem().unwrap_or_default().to_string_lossy();
        frames.add(&frame.rgb, &expected, &place);
    }
    if let Some(expected) = numbers("draw") {
        let mut rng = LegacyRng::seed(run.start.seed);
        episode.environment().reset(&mut rng, Reset::Hard, MODEL_LOADS)?;
        if let Some(corruption) = run.start.corruption {
            for _ in 0..PICTURES {
                corruption.skip(SIDE, SIDE, &mut rng);
            }
        }
        findings.draw = Some(*expected == [rng.random_sample()]);
    }
    if let Some(expected) = numbers("trial-1") {
        let row = ManifestRow { init_id: 1, ..run.row };
        let start = VariantStart { earlier_resets: 1, ..run.start };
        let mut episode = simulator.begin_variant(run.files, &row, Realisation::Matched, &start)?;
        episode.settle()?;
        let found = episode.environment().state();
        findings.states = findings.states.max(difference(&found, expected)?);
    }
    Ok(findings)
}

/// Returns the place of a camera's picture of a case; `None` if no picture of it was recorded.
fn picture(
    pictures: &Path,
    benchmark: Benchmark,
    recording: &Recording,
    camera: &str,
) -> Option<PathBuf> {
    let number = recording.number?;
    Some(pictures.join(format!("{}_{number:02}_{camera}.png", benchmark.tag())))
}

impl Prompts {
    fn equal(&self, recording: &Recording) -> Option<bool> {
        let is_equal = |text: &str, expected: &Option<String>| match expected {
            Some(expected) => digest(text) == *expected,
            None => true,
        };
        recording.prompt.as_ref()?;
        let is_prompt = is_equal(&self.prompt, &recording.prompt);
        Some(is_prompt && is_equal(&self.sentence, &recording.sentence))
    }
}

fn digest(text: &str) -> String {
    hex::encode(Sha256::digest(text.as_bytes()))
}

fn camera(environment: &Environment) -> Result<Vec<f64>> {
    let model = environment.model();
    let camera = model.id(ObjectKind::Camera, "agentview");
    let camera = camera.context("the scene has no camera agentview")?;
    let (pos, quat) = (&model.cam_pos()[camera * 3..], &model.cam_quat()[camera * 4..]);
    Ok([&pos[..3], &quat[..4]].concat())
}

fn difference(found: &[f64], expected: &[f64]) -> Result<f64> {
    ensure!(found.len() == expected.len(), "{} numbers instead of {}", found.len(), expected.len());
    let pairs = found.iter().zip(expected);
    Ok(pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max))
}

fn task_of(suite: ProSuite, name: &str) -> Result<TaskRef> {
    let mut tasks = suite.suite.tasks();
    let task = tasks.find(|task| task.name() == name);
    task.with_context(|| format!("{suite} has no task {name}"))
}

fn number_of_task(name: &str) -> Result<usize> {
    let number = name.rsplit_once("_eval").map(|(_, rest)| rest);
    let number = number.and_then(|rest| rest.split_once("_ver"));
    let (number, _) = number.context("the name has no _eval and _ver")?;
    Ok(number.parse()?)
}

/// Returns the task of a file of LIBERO-Para, which numbers libero_goal's tasks alphabetically.
fn task_of_sentence(name: &str) -> Result<TaskRef> {
    let mut tasks: Vec<TaskRef> = Suite::Goal.tasks().collect();
    tasks.sort_by_key(|task| task.name());
    let task = tasks.get(number_of_task(name)?).copied();
    task.context("libero_goal has ten tasks")
}
