//! Errors of scenes, pictures and simulations, and of the worker.

use assets::AssetsError;
use libero_ctrl::numpy::LegacyRng;
use libero_ctrl::{Delays, Execution, NoSuchRow, SuiteFile, TooLate};
use libero_family::SelectionError;
use libero_family::corruption::{Corruption, Picture, UnsuitedPicture};
use libero_family::plus::{BddlPath, ProblemClass, UnknownVariant};
use libero_family::protocol::{Benchmark, Protocol};
use policy_protocol::{ActionFault, DescriptionFault};
use raster::{DrawError, ModelError};
use scene::SceneError;
use sim::mujoco::ObjectKind;
use sim::{SceneFileError, SimError};
use tonic::Status;
use transport::{AccessError, EndpointError};
use video::VideoError;
use worker::actor::PolicyError;
use worker::assets::PackError;
use worker::film::FilmError;
use worker::measure::MeasureError;
use worker::measure::limits::LimitError;
use worker::preview::PreviewError;
use worker::rescue::RescueError;
use worker::rollout::RolloutError;
use worker::single::SingleError;
use worker::slot::SlotError;
use worker::supervise::SuperviseError;
use worker::variants::VariantsError;

use crate::{Messages, io_error, path, text, variants};

pub(crate) fn add(messages: &mut Messages) {
    scenes(messages);
    pictures(messages);
    simulator(messages);
    rollouts(messages);
    supervision(messages);
    assets(messages);
}

fn no_scene() -> SceneError {
    SceneError::Inconsistent("joint `a` is there twice".to_owned())
}

fn no_policy() -> PolicyError {
    PolicyError::Unavailable {
        call: "query 3".to_owned(),
        policy: String::new(),
        endpoint: "grpc://gpu-3:1".to_owned(),
        problem: "no answer within 60 s".to_owned(),
        answered: Some(3),
    }
}

fn too_late() -> TooLate {
    let execution: Execution = "overlap:12".parse().expect("a model");
    execution.check(10).expect_err("too late")
}

fn scenes(messages: &mut Messages) {
    messages.add("BddlError", scene::Problem::parse("(define (problem x)").expect_err("no end"));
    variants!(messages, SceneError,
        SceneError::Read { .. } => SceneError::Read {
            what: "the BDDL file".to_owned(), path: path(), remedy: "give its path".to_owned(),
            source: io_error(),
        },
        SceneError::Unpack { .. } => SceneError::Unpack { path: path(), source: io_error() },
        SceneError::Malformed { .. } => SceneError::Malformed {
            what: "the BDDL file".to_owned(), path: path(), problem: "line 3: no name".to_owned(),
        },
        SceneError::UnknownCategory { .. } => SceneError::UnknownCategory {
            category: "mugg".to_owned(), instance: "mug_1".to_owned(), known: 60,
        },
        SceneError::UnknownProblem { .. } => SceneError::UnknownProblem {
            problem: text(), known: vec!["libero_floor_manipulation"],
        },
        SceneError::NotLiberos { .. } => SceneError::NotLiberos {
            what: "the arena model".to_owned(), path: path(),
            difference: "altered: another SHA-256".to_owned(),
        },
        SceneError::NoWheel => SceneError::NoWheel,
        SceneError::Checkout { .. } => SceneError::Checkout {
            path: path(), problem: "3 of 4093 files are missing".to_owned(),
        },
        SceneError::Assets(_) => SceneError::Assets(AssetsError::Interrupted),
        SceneError::Inconsistent(_) => no_scene(),
        SceneError::NoRoom { .. } => SceneError::NoRoom {
            object: "mug_1".to_owned(), region: "table".to_owned(), attempts: 5_000,
        },
    );
}

fn pictures(messages: &mut Messages) {
    variants!(messages, ModelError,
        ModelError::Texture { .. } => ModelError::Texture {
            width: 3, height: 4, channels: 5, bytes: 6,
        },
        ModelError::Bytes => ModelError::Bytes,
        ModelError::Quality { .. } => ModelError::Quality { slices: 0, stacks: 0, quads: 0 },
    );
    variants!(messages, DrawError,
        DrawError::Size { .. } => DrawError::Size { width: 0, height: 5_000 },
        DrawError::Camera { .. } => DrawError::Camera {
            what: "field of view", value: 0.0, needed: "give 1 to 179 degrees",
        },
        DrawError::Missing { .. } => DrawError::Missing {
            geom: 3, what: "mesh", index: 9, count: 4,
        },
        DrawError::MissingSky { .. } => DrawError::MissingSky { index: 9, count: 4 },
        DrawError::Shadows { .. } => DrawError::Shadows { size: 2 },
        DrawError::Texels { .. } => DrawError::Texels { texture: 1, given: 2, needed: 3 },
    );
    variants!(messages, VideoError,
        VideoError::PaneSize { .. } => VideoError::PaneSize { given: 7 },
        VideoError::Encode { .. } => VideoError::from(openh264::Error::msg("no room")),
        VideoError::Mux(_) => VideoError::Mux(muxide::api::MuxerError::MissingTrackConfig),
    );
}

/// Returns the error for a picture of a size that the fog corruption cannot cover.
fn unsuited_picture() -> UnsuitedPicture {
    let mut picture = Picture { height: 300, width: 300, rgb: &mut vec![0; 300 * 300 * 3] };
    let fog = Corruption::new(31).expect("a corruption");
    let refused = fog.apply(&mut picture, &mut LegacyRng::seed(1));
    refused.expect_err("it is too large")
}

fn simulator(messages: &mut Messages) {
    messages.add("UnsuitedPicture", unsuited_picture());
    messages.add("ProblemError", ProblemClass::parse("libero_moon").expect_err("none"));
    for path in [
        "a_view_b/c_view_0_0_100_0_0_initstate_0.bddl",
        "c_initstate_0_view_0_0_100_0_0.bddl",
        "c_view_0_0_0_0_0_initstate_0.bddl",
        "c_view_0_0_100_0_0_initstate_501.bddl",
        "c_view_0_0_100_0_0_initstate_0_noise_51.bddl",
    ] {
        let invalid = BddlPath::parse(path).expect_err("invalid");
        messages.add("InvalidBddlPath", invalid);
    }
    variants!(messages, UnknownVariant,
        UnknownVariant::Empty => UnknownVariant::Empty,
        UnknownVariant::Unchanged(_) => UnknownVariant::Unchanged(text()),
        UnknownVariant::Task(_) => UnknownVariant::Task(text()),
        UnknownVariant::Suffix { .. } => UnknownVariant::Suffix { name: text(), suffix: text() },
    );
    variants!(messages, SimError,
        SimError::Scene(_) => SimError::Scene(no_scene()),
        SimError::Compile(_) => SimError::Compile("Error: repeated name".to_owned()),
        SimError::Missing { .. } => SimError::Missing { kind: ObjectKind::Body, name: text() },
        SimError::StateWidth { .. } => SimError::StateWidth {
            id: 1, file: text(), found: 71, needed: 79,
        },
        SimError::NoSuchState { .. } => SimError::NoSuchState { id: 60, file: text(), count: 50 },
        SimError::Unstable { .. } => SimError::Unstable {
            control_step: 4, problem: "velocities are no numbers".to_owned(),
        },
        SimError::Singular { .. } => SimError::Singular { control_step: 4 },
        SimError::Predicate { .. } => SimError::Predicate {
            predicate: "(on a b)".to_owned(), problem: "`a` has no such region".to_owned(),
        },
        SimError::DistortedPose => SimError::DistortedPose,
        SimError::Camera(_) => SimError::Camera("frontview".to_owned()),
        SimError::Corruption(_) => SimError::from(unsuited_picture()),
        SimError::Graphics { .. } => SimError::Graphics {
            problem: "there is no device".to_owned(), remedy: "use --renderer software",
        },
        SimError::OutOfMemory(_) => SimError::OutOfMemory("a state"),
    );
    variants!(messages, SceneFileError,
        SceneFileError::File { .. } => SceneFileError::File {
            doing: "write", path: path(), source: io_error(),
        },
        SceneFileError::Untrusted { .. } => SceneFileError::Untrusted {
            path: path(), owner: 1_000, mode: 0o777,
        },
        SceneFileError::Busy { .. } => SceneFileError::Busy { path: path(), secs: 60 },
        SceneFileError::Limit { .. } => SceneFileError::Limit { given: "8G".to_owned() },
        SceneFileError::Layout => SceneFileError::Layout,
    );
}

fn rollouts(messages: &mut Messages) {
    messages.add("TooLate", too_late());
    messages.add("ExecutionError", "dawdle:3".parse::<Execution>().expect_err("no model"));
    messages.add("LatencyFileError", Delays::from_json("{}").expect_err("no delays"));
    variants!(messages, PolicyError,
        PolicyError::Endpoint(_) => PolicyError::Endpoint(EndpointError { given: text() }),
        PolicyError::Access(_) => PolicyError::Access(AccessError::Host { host: text() }),
        PolicyError::Runtime(_) => PolicyError::Runtime(io_error()),
        PolicyError::Unavailable { .. } => no_policy(),
        PolicyError::Description { .. } => PolicyError::Description {
            policy: String::new(), endpoint: text(),
            fault: DescriptionFault::Horizon { horizon: 0 },
        },
        PolicyError::InvalidAnswer { .. } => PolicyError::InvalidAnswer {
            call: "query 3".to_owned(), policy: text(), endpoint: "grpc://gpu-3:1".to_owned(),
            fault: ActionFault::Empty,
        },
        PolicyError::Failed { .. } => PolicyError::Failed {
            call: "Reset".to_owned(), policy: text(), endpoint: "grpc://gpu-3:1".to_owned(),
            problem: "no such suite".to_owned(),
        },
        PolicyError::TooLate { .. } => PolicyError::TooLate {
            policy: text(), problem: too_late(),
        },
        PolicyError::RecordingEnded { .. } => PolicyError::RecordingEnded {
            path: path(), actions: 12,
        },
    );
    variants!(messages, RolloutError,
        RolloutError::Simulator { .. } => RolloutError::Simulator {
            title: "object/t0/clean/i03".to_owned(), source: SimError::OutOfMemory("a state"),
        },
        RolloutError::Policy(_) => RolloutError::Policy(no_policy()),
        RolloutError::Abandoned => RolloutError::Abandoned,
    );
    variants!(messages, SelectionError,
        SelectionError::Nothing => SelectionError::Nothing,
        SelectionError::Foreign { .. } => SelectionError::Foreign {
            protocol: "plus-rlinf", benchmark: "libero-pro",
        },
        SelectionError::Unused { .. } => SelectionError::Unused { name: text() },
        SelectionError::Filter { .. } => SelectionError::Filter {
            benchmark: "libero-pro", filter: "dimensions",
        },
        SelectionError::Range { .. } => SelectionError::Range {
            field: "trials", given: 51, valid: [1, 50],
        },
        SelectionError::Id { .. } => SelectionError::Id {
            id: "goal/t8/plus:noise_51/i00".parse().expect("an id"),
        },
        SelectionError::Lacking { .. } => SelectionError::Lacking {
            lacking: 3, chosen: 5, report: text(),
        },
        SelectionError::Variant(_) => SelectionError::Variant(UnknownVariant::Empty),
        SelectionError::Name(_) => {
            SelectionError::Name("plus".parse::<Protocol>().expect_err("no protocol"))
        },
    );
    variants!(messages, VariantsError,
        VariantsError::Selection(_) => VariantsError::Selection(SelectionError::Nothing),
        VariantsError::Task(_) => VariantsError::Task(no_scene()),
        VariantsError::Single(_) => VariantsError::Single(SingleError::Rollout(
            RolloutError::Abandoned,
        )),
        VariantsError::Start { .. } => VariantsError::Start {
            id: "goal/t8/plus:noise_30/i00".parse().expect("an id"),
            source: Box::new(SimError::Scene(no_scene())),
        },
        VariantsError::SuiteFile { .. } => VariantsError::SuiteFile {
            path: path(), source: SuiteFile::from_json("{}").expect_err("no suite file"),
        },
        VariantsError::Pinned { .. } => VariantsError::Pinned {
            path: path(), what: "protocol", found: text(), expected: text(),
        },
        VariantsError::Malformed { .. } => VariantsError::Malformed {
            path: path(), line: 3, problem: "no `success`".to_owned(),
        },
        VariantsError::File { .. } => VariantsError::File { path: path(), source: io_error() },
    );
    variants!(messages, SingleError,
        SingleError::Row(_) => SingleError::Row(NoSuchRow {
            id: "object/t0/clean/i03".parse().expect("an id"),
            problem: "there are 50 initial states".to_owned(),
        }),
        SingleError::Task(_) => SingleError::Task(no_scene()),
        SingleError::Recorded { .. } => SingleError::Recorded {
            path: path(), problem: "it holds no action".to_owned(),
        },
        SingleError::Policy(_) => SingleError::Policy(no_policy()),
        SingleError::Rollout(_) => SingleError::Rollout(RolloutError::Abandoned),
        SingleError::Write { .. } => SingleError::Write { path: path(), source: io_error() },
    );
    let failing = || "object/t0/combination/L2/c00".parse().expect("an id");
    variants!(messages, RescueError,
        RescueError::NotPerturbed(_) => RescueError::NotPerturbed(failing()),
        RescueError::Succeeds { .. } => RescueError::Succeeds { id: failing(), steps: 86 },
        RescueError::Rollout(_) => RescueError::Rollout(RolloutError::Abandoned),
        RescueError::Film(_) => RescueError::Film(Box::new(io_error())),
        RescueError::Write { .. } => RescueError::Write { path: path(), source: io_error() },
    );
    variants!(messages, PreviewError,
        PreviewError::Simulate(_) => PreviewError::Simulate(SimError::OutOfMemory("a state")),
        PreviewError::Write { .. } => PreviewError::Write {
            path: path(), problem: io_error().to_string(),
        },
    );
    variants!(messages, MeasureError,
        MeasureError::Cores(_) => MeasureError::Cores(io_error()),
        MeasureError::Memory { .. } => MeasureError::Memory {
            field: "MemAvailable", file: path(),
        },
        MeasureError::Start { .. } => MeasureError::Start { program: path(), source: io_error() },
        MeasureError::Ended { .. } => MeasureError::Ended {
            slot: 0, end: "ended with exit status 1".to_owned(),
        },
        MeasureError::Silent { .. } => MeasureError::Silent { slots: 4, secs: 60.0 },
        MeasureError::Exchange(_) => MeasureError::Exchange(io_error()),
        MeasureError::Rollout(_) => MeasureError::Rollout(RolloutError::Abandoned),
    );
    variants!(messages, LimitError,
        LimitError::TooMany { .. } => LimitError::TooMany {
            slots: 9, shortage: "this process may use 1 core".to_owned(),
        },
        LimitError::Machine(_) => LimitError::Machine(MeasureError::Cores(io_error())),
    );
}

fn supervision(messages: &mut Messages) {
    let no_id = || "x".parse::<rollout_types::AttemptId>().expect_err("no id");
    messages.add("AttemptIdError", no_id());
    variants!(messages, SuperviseError,
        SuperviseError::Endpoint(_) => SuperviseError::Endpoint(EndpointError { given: text() }),
        SuperviseError::Access(_) => SuperviseError::Access(AccessError::Host { host: text() }),
        SuperviseError::Refused { .. } => SuperviseError::Refused {
            url: "http://h:1".to_owned(), answer: "nothing listens there".to_owned(),
        },
        SuperviseError::Stopped(_) => SuperviseError::Stopped("it failed too often".to_owned()),
        SuperviseError::Lease { .. } => SuperviseError::Lease { url: text(), source: no_id() },
        SuperviseError::Panicked(_) => SuperviseError::Panicked("a task".to_owned()),
        SuperviseError::Renderers { .. } => SuperviseError::Renderers {
            slot: 1, renderer: "gl".to_owned(), registered: "software".to_owned(),
        },
        SuperviseError::Exhausted { .. } => SuperviseError::Exhausted {
            slot: 1, error: io_error(),
        },
        SuperviseError::Slot { .. } => SuperviseError::Slot {
            slot: 1, end: "ended with exit status 1".to_owned(),
        },
    );
    variants!(messages, SlotError,
        SlotError::Signals(_) => SlotError::Signals(io_error()),
        SlotError::Simulator(_) => SlotError::Simulator(SimError::OutOfMemory("a state")),
        SlotError::Parent(_) => SlotError::Parent(io_error()),
    );
    variants!(messages, FilmError,
        FilmError::Threads(_) => FilmError::Threads(io_error()),
        FilmError::Folder(_) => FilmError::Folder(io_error()),
        FilmError::Link(_) => FilmError::Link(SuperviseError::Panicked("a task".to_owned())),
        FilmError::Refused { .. } => FilmError::Refused {
            url: "http://h:1".to_owned(), status: Box::new(Status::unimplemented("")),
        },
    );
}

fn assets(messages: &mut Messages) {
    let url = || "https://index.example/simple/a".to_owned();
    variants!(messages, PackError,
        PackError::Scene(_) => PackError::Scene(no_scene()),
        PackError::Assets(_) => PackError::Assets(AssetsError::Interrupted),
        PackError::Incomplete { .. } => PackError::Incomplete {
            folder: path(), description: "lacks the arena of libero_goal".to_owned(),
        },
        PackError::Differs { .. } => PackError::Differs {
            folder: path(), count: 1, named: "a.xml (missing)".to_owned(),
        },
        PackError::Primitives { .. } => PackError::Primitives { folder: path() },
        PackError::Checkout { .. } => PackError::Checkout { benchmark: Benchmark::Plus },
        PackError::Print(_) => PackError::Print(io_error()),
    );
    variants!(messages, AssetsError,
        AssetsError::Read { .. } => AssetsError::Read { path: path(), source: io_error() },
        AssetsError::Write { .. } => AssetsError::Write { path: path(), source: io_error() },
        AssetsError::Interrupted => AssetsError::Interrupted,
        AssetsError::Url { .. } => AssetsError::Url {
            what: "package index", remedy: "write https://HOST/PATH",
        },
        AssetsError::Unreachable { .. } => AssetsError::Unreachable {
            url: url(), problem: "nothing listens there".to_owned(), tries: 5,
        },
        AssetsError::Refused { .. } => AssetsError::Refused {
            url: url(), status: 404, remedy: "choose another source with --index",
        },
        AssetsError::NotInIndex { .. } => AssetsError::NotInIndex {
            index: url(), project: "a".to_owned(), problem: "the server answers 404".to_owned(),
        },
        AssetsError::NoWheel { .. } => AssetsError::NoWheel { path: path() },
        AssetsError::Answer { .. } => AssetsError::Answer {
            url: url(), problem: crate::json_error().to_string(),
            remedy: "choose another source with --index",
        },
        AssetsError::Altered { .. } => AssetsError::Altered {
            file: "a.xml".to_owned(), url: url(), problem: "the file has 3 bytes, not 4".to_owned(),
            tries: 5,
        },
    );
}
