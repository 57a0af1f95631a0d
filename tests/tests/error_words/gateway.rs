//! Errors of the policy-gateway, its back-ends and the examination of policy servers.

use std::time::Duration;

use policy_backends::builtin::{Builtin, student::WeightsFileError};
use policy_backends::grpc::GrpcAddress;
use policy_backends::numpy::ArrayError;
use policy_backends::openpi::OpenpiAddress;
use policy_backends::openpi::codec::AnswerError;
use policy_backends::recording::RecordingError;
use policy_backends::spec::BackendSpecError;
use policy_backends::vla_eval::{AnswerError as VlaEvalAnswerError, VlaEvalAddress};
use policy_backends::{BackendError, BackendSpec, Cause, UnusableBackend};
use policy_doctor::command::CommandError;
use policy_doctor::conformance::ConformanceError;
use policy_doctor::server::ExaminationError;
use policy_doctor::situation::MissingInput;
use policy_gateway::RunError;
use policy_gateway::config::{ConfigError, RouteName, RouteSpec};
use policy_gateway::front::FrontError;
use policy_gateway::route::RouteError;
use policy_protocol::{ActionFault, DescriptionFault};
use tonic::Status;
use transport::{AccessError, ConnectError, ProbeResult, SecurityError, ServerKind, Settings};

use crate::{Messages, io_error, path, text, variants};

pub(crate) fn add(messages: &mut Messages) {
    configuration(messages);
    checks(messages);
    back_ends(messages);
    routes(messages);
    conformance(messages);
    examination(messages);
}

fn name() -> RouteName {
    "pi05".parse().expect("a name")
}

fn connect_error() -> Box<ConnectError> {
    Box::new(ConnectError {
        expected: ServerKind::Policy,
        host: "gpu-3".to_owned(),
        found: ProbeResult::Nothing,
        has_authority: false,
        settings: Settings {
            address: "its route",
            authority: "`ca` of the policy",
            clear: "grpc://",
            encrypted: "https://",
        },
    })
}

fn configuration(messages: &mut Messages) {
    let no_name = || "a b".parse::<RouteName>().expect_err("no name");
    let no_builtin = || "nope".parse::<Builtin>().expect_err("no policy");
    let no_address = || "grpc://h".parse::<GrpcAddress>().expect_err("no port");
    let no_openpi = || "ws://h".parse::<OpenpiAddress>().expect_err("no port");
    messages.add("RouteNameError", no_name());
    messages.add("UnknownBuiltin", no_builtin());
    messages.add("AddressError", no_address());
    messages.add("OpenpiAddressError", no_openpi());
    let no_vla_eval = || {
        let text = "vla-eval://h";
        text.parse::<VlaEvalAddress>().expect_err("no port")
    };
    messages.add("VlaEvalAddressError", no_vla_eval());
    let no_back_end = || "nobody".parse::<BackendSpec>().expect_err("no back-end");
    variants!(messages, ConfigError,
        ConfigError::NoRoute => ConfigError::NoRoute,
        ConfigError::Unreadable { .. } => ConfigError::Unreadable {
            path: path(), source: io_error(),
        },
        ConfigError::Toml { .. } => ConfigError::Toml {
            path: path(), line: 2, problem: libero_ctrl::plain_words("missing field `x`"),
        },
        ConfigError::InFile { .. } => ConfigError::InFile {
            path: path(), source: Box::new(ConfigError::NoRoute),
        },
        ConfigError::NoReplica { .. } => ConfigError::NoReplica { name: name() },
        ConfigError::ReplicasAndSuites { .. } => ConfigError::ReplicasAndSuites { name: name() },
        ConfigError::TooManyReplicas { .. } => ConfigError::TooManyReplicas { name: name() },
        ConfigError::DuplicateReplica { .. } => ConfigError::DuplicateReplica {
            name: name(), replica: "grpc://h:1".to_owned(),
        },
        ConfigError::AnswerWithin { .. } => ConfigError::AnswerWithin { name: name(), secs: 0.0 },
        ConfigError::Form { .. } => "pi05".parse::<RouteSpec>().expect_err("no back-end"),
        ConfigError::Name(_) => ConfigError::Name(no_name()),
        ConfigError::DuplicateRoute { .. } => ConfigError::DuplicateRoute { name: name() },
        ConfigError::Backend(_) => ConfigError::Backend(no_back_end()),
        ConfigError::NoAuthority { .. } => ConfigError::NoAuthority {
            name: name(), replica: "https://h:1".to_owned(),
        },
    );
    variants!(messages, BackendSpecError,
        BackendSpecError::Kind { .. } => no_back_end(),
        BackendSpecError::Builtin(_) => BackendSpecError::Builtin(no_builtin()),
        BackendSpecError::Address(_) => BackendSpecError::Address(no_address()),
        BackendSpecError::Openpi(_) => BackendSpecError::Openpi(no_openpi()),
        BackendSpecError::VlaEval(_) => BackendSpecError::VlaEval(no_vla_eval()),
    );
    variants!(messages, UnusableBackend,
        UnusableBackend::Access(_) => {
            UnusableBackend::Access(AccessError::Host { host: text() })
        },
        UnusableBackend::Recording(_) => {
            UnusableBackend::Recording(RecordingError::NoRecordings { folder: path() })
        },
        UnusableBackend::Weights(_) => UnusableBackend::Weights(WeightsFileError::Unreadable {
            path: path(), source: io_error(),
        }),
        UnusableBackend::Address(_) => UnusableBackend::Address(no_address()),
        UnusableBackend::Openpi(_) => UnusableBackend::Openpi(no_openpi()),
        UnusableBackend::VlaEval(_) => UnusableBackend::VlaEval(no_vla_eval()),
    );
    variants!(messages, RecordingError,
        RecordingError::Io { .. } => RecordingError::Io { path: path(), source: io_error() },
        RecordingError::Broken { .. } => RecordingError::Broken { path: path() },
        RecordingError::NoRecordings { .. } => RecordingError::NoRecordings { folder: path() },
        RecordingError::TooMany { .. } => RecordingError::TooMany { folder: path() },
        RecordingError::DifferentPolicies { .. } => RecordingError::DifferentPolicies {
            first: path(), other: path(), difference: "their horizons differ".to_owned(),
        },
    );
}

fn checks(messages: &mut Messages) {
    variants!(messages, ActionFault,
        ActionFault::Width { .. } => ActionFault::Width { width: 6 },
        ActionFault::Empty => ActionFault::Empty,
        ActionFault::Ragged { .. } => ActionFault::Ragged { numbers: 13 },
        ActionFault::TooMany { .. } => ActionFault::TooMany { count: 3, horizon: 2 },
        ActionFault::NotFinite { .. } => ActionFault::NotFinite {
            action: 0, component: 1, value: f32::NAN,
        },
        ActionFault::TooLarge { .. } => ActionFault::TooLarge {
            action: 0, component: 1, value: 1e9,
        },
    );
    variants!(messages, DescriptionFault,
        DescriptionFault::Nameless => DescriptionFault::Nameless,
        DescriptionFault::Horizon { .. } => DescriptionFault::Horizon { horizon: 0 },
        DescriptionFault::Execute { .. } => DescriptionFault::Execute { execute: 9, horizon: 8 },
        DescriptionFault::StateField { .. } => DescriptionFault::StateField { field: 99 },
        DescriptionFault::Version { .. } => DescriptionFault::Version { given: 2 },
        DescriptionFault::Camera { .. } => DescriptionFault::Camera { name: text() },
        DescriptionFault::FrameSide { .. } => DescriptionFault::FrameSide {
            camera: text(), width: 0, height: 256,
        },
        DescriptionFault::Text { .. } => DescriptionFault::Text { field: "checkpoint", bytes: 513 },
        DescriptionFault::RepeatedStateField { .. } => {
            DescriptionFault::RepeatedStateField { field: 1 }
        },
        DescriptionFault::Cameras { .. } => DescriptionFault::Cameras { count: 9 },
        DescriptionFault::RepeatedCamera { .. } => DescriptionFault::RepeatedCamera {
            camera: text(), width: 256, height: 256,
        },
        DescriptionFault::Settings { .. } => DescriptionFault::Settings {
            problem: "names setting `execute` twice".to_owned(),
        },
    );
    variants!(messages, AnswerError,
        AnswerError::NoMessage => AnswerError::NoMessage,
        AnswerError::NoActions => AnswerError::NoActions,
        AnswerError::Array(_) => AnswerError::Array(ArrayError::NotAnArray),
        AnswerError::Shape { .. } => AnswerError::Shape { shape: vec![3] },
    );
    variants!(messages, ArrayError,
        ArrayError::NotAnArray => ArrayError::NotAnArray,
        ArrayError::Dtype { .. } => ArrayError::Dtype { dtype: "<i8".to_owned() },
    );
    variants!(messages, VlaEvalAnswerError,
        VlaEvalAnswerError::NoMessage => VlaEvalAnswerError::NoMessage,
        VlaEvalAnswerError::Kind { .. } => VlaEvalAnswerError::Kind { kind: text() },
        VlaEvalAnswerError::OutOfStep { .. } => VlaEvalAnswerError::OutOfStep { number: 3, asked: 4 },
        VlaEvalAnswerError::Policy(_) => VlaEvalAnswerError::Policy(text()),
        VlaEvalAnswerError::Start(_) => VlaEvalAnswerError::Start(text()),
        VlaEvalAnswerError::NoActions => VlaEvalAnswerError::NoActions,
        VlaEvalAnswerError::Array(_) => VlaEvalAnswerError::Array(ArrayError::NotAnArray),
        VlaEvalAnswerError::Shape { .. } => VlaEvalAnswerError::Shape { shape: vec![2, 3, 7] },
        VlaEvalAnswerError::Chunk { .. } => VlaEvalAnswerError::Chunk { count: 8 },
        VlaEvalAnswerError::Single { .. } => VlaEvalAnswerError::Single { execute: 8 },
        VlaEvalAnswerError::Empty { .. } => VlaEvalAnswerError::Empty { execute: 8 },
        VlaEvalAnswerError::Short { .. } => VlaEvalAnswerError::Short { count: 4, execute: 8 },
    );
}

fn back_ends(messages: &mut Messages) {
    let address = || "gpu-3:5000".to_owned();
    let backend = || "grpc://gpu-3:5000".to_owned();
    let problem_text = || "nothing listens there; start it".to_owned();
    for cause in [
        Cause::Unreachable(problem_text()),
        Cause::Misconfigured(problem_text()),
        Cause::TokenRejected(problem_text()),
        Cause::DescriptionDiffers("describes itself otherwise".to_owned()),
        Cause::NoAnswer,
        Cause::RepeatedError("ValueError: shape".to_owned()),
        Cause::Broken("CUDA error".to_owned()),
    ] {
        match &cause {
            Cause::Unreachable(_)
            | Cause::Misconfigured(_)
            | Cause::TokenRejected(_)
            | Cause::DescriptionDiffers(_)
            | Cause::NoAnswer
            | Cause::RepeatedError(_)
            | Cause::Broken(_) => {}
        }
        messages.add("BackendError", BackendError::Broken { backend: backend(), cause });
    }
    variants!(messages, BackendError,
        BackendError::Unreachable { .. } => BackendError::Unreachable {
            address: address(), trouble: connect_error(),
        },
        BackendError::TokenRejected { .. } => BackendError::TokenRejected {
            address: address(), reason: "it answered HTTP 401".to_owned(),
        },
        BackendError::OutOfService { .. } => BackendError::OutOfService {
            backend: backend(), cause: Cause::Unreachable(problem_text()),
            retry_in: Duration::from_secs(1),
        },
        BackendError::TimedOut { .. } => BackendError::TimedOut {
            backend: backend(), limit: Duration::from_secs(1),
        },
        BackendError::Broken { .. } => BackendError::Broken {
            backend: backend(), cause: Cause::NoAnswer,
        },
        BackendError::Description { .. } => BackendError::Description {
            policy: text(), fault: DescriptionFault::Nameless,
        },
        BackendError::DescriptionDiffers { .. } => BackendError::DescriptionDiffers {
            difference: "has another checkpoint".to_owned(),
        },
        BackendError::InvalidActions { .. } => BackendError::InvalidActions {
            fault: ActionFault::Empty,
        },
        BackendError::QueueFull { .. } => BackendError::QueueFull { queued: 64 },
        BackendError::Overloaded { .. } => BackendError::Overloaded {
            backend: backend(), waited: Duration::from_secs(55),
        },
        BackendError::BatchLost => BackendError::BatchLost,
        BackendError::BatchSize { .. } => BackendError::BatchSize { asked: 4, answered: 3 },
        BackendError::Refused { .. } => BackendError::Refused {
            address: address(), status: Box::new(Status::internal("")),
        },
        BackendError::UnsupportedPolicy { .. } => BackendError::UnsupportedPolicy {
            address: address(), reason: "it answers poses; serve motions".to_owned(),
        },
        BackendError::SessionLost => BackendError::SessionLost,
        BackendError::OutOfOrder { .. } => BackendError::OutOfOrder { expected: 3 },
        BackendError::Policy { .. } => BackendError::Policy { message: text() },
    );
}

fn routes(messages: &mut Messages) {
    variants!(messages, RouteError,
        RouteError::Replica { .. } => RouteError::Replica {
            route: name(), replica: "grpc://h:1".to_owned(),
            source: Box::new(BackendError::Unreachable {
                address: "h:1".to_owned(), trouble: connect_error(),
            }),
        },
        RouteError::Action { .. } => RouteError::Action {
            route: name(), replica: "grpc://h:1".to_owned(), query_index: 3,
            source: ActionFault::Empty,
        },
        RouteError::SessionLost { .. } => RouteError::SessionLost {
            route: name(), session: "s".to_owned(),
        },
        RouteError::Suite { .. } => RouteError::Suite {
            route: name(), suite: text(), known: "libero_goal".to_owned(),
        },
        RouteError::Session { .. } => RouteError::Session { bytes: 0 },
        RouteError::Retired { .. } => RouteError::Retired { route: name() },
        RouteError::Full { .. } => RouteError::Full {
            route: name(), sessions: 137, per_query: Duration::from_millis(400),
        },
        RouteError::Overloaded => RouteError::Overloaded,
    );
    variants!(messages, RunError,
        RunError::Socket { .. } => RunError::Socket { problem: io_error().to_string() },
        RunError::Security(_) => RunError::Security(SecurityError::Tls),
    );
}

fn conformance(messages: &mut Messages) {
    let url = || "grpc://h:1".to_owned();
    variants!(messages, ConformanceError,
        ConformanceError::Url { .. } => ConformanceError::Url { url: text() },
        ConformanceError::Access(_) => {
            ConformanceError::Access(AccessError::Host { host: text() })
        },
        ConformanceError::Connect { .. } => ConformanceError::Connect {
            url: url(), trouble: connect_error(),
        },
        ConformanceError::Describe { .. } => ConformanceError::Describe {
            url: url(), status: Box::new(Status::unknown("")),
        },
        ConformanceError::Episode { .. } => ConformanceError::Episode {
            url: url(), status: Box::new(Status::unknown("")),
        },
    );
    variants!(messages, FrontError,
        FrontError::Config(_) => FrontError::Config(ConfigError::NoRoute),
        FrontError::Backend(_) => FrontError::Backend(UnusableBackend::Access(
            AccessError::Host { host: text() },
        )),
        FrontError::Listen(_) => FrontError::Listen(io_error()),
    );
}

fn examination(messages: &mut Messages) {
    let url = || "grpc://h:1".to_owned();
    let recordings = || RecordingError::NoRecordings { folder: path() };
    variants!(messages, ExaminationError,
        ExaminationError::Backend(_) => ExaminationError::Backend(UnusableBackend::Access(
            AccessError::Host { host: text() },
        )),
        ExaminationError::Recording(_) => ExaminationError::Recording(recordings()),
        ExaminationError::OneLook => ExaminationError::OneLook,
        ExaminationError::NoAnswer { .. } => ExaminationError::NoAnswer { url: url() },
        ExaminationError::Answer { .. } => ExaminationError::Answer {
            url: url(), problem: "nothing listens there; start it".to_owned(),
        },
        ExaminationError::Description { .. } => ExaminationError::Description {
            url: url(), fault: DescriptionFault::Nameless,
        },
        ExaminationError::InvalidActions { .. } => ExaminationError::InvalidActions {
            url: url(), fault: ActionFault::Empty,
        },
        ExaminationError::MissingInput { .. } => ExaminationError::MissingInput {
            url: url(), missing: MissingInput::Privileged,
        },
    );
    variants!(messages, CommandError,
        CommandError::Access(_) => CommandError::Access(AccessError::Host { host: text() }),
        CommandError::Examination(_) => {
            CommandError::Examination(ExaminationError::NoAnswer { url: url() })
        },
    );
}
