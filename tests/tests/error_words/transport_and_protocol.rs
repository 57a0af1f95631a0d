//! Errors of connections and access, and of the benchmark's text formats: names, rows, designs,
//! specifications and manifests.

use libero_ctrl::manifest::{LineProblem, ManifestErrors};
use libero_ctrl::{
    AxisSet, Condition, DesignError, Level, NoSuchRow, PerturbError, RolloutId, RowError,
    SpecError, StopError, SuiteFile, SuiteFileError, UnknownName, VariantsError,
};
use transport::{
    AccessError, CertificateFault, ConnectError, EndpointError, ProbeResult, SecurityError,
    ServerKind, Settings, TokenError, Untrusted,
};

use crate::{Messages, io_error, path, text, variants};

const SETTINGS: Settings =
    Settings { address: "--connect", authority: "--ca", clear: "http://", encrypted: "https://" };

fn no_suite_file() -> SuiteFileError {
    SuiteFile::from_json("{}").expect_err("no suite file")
}

pub(crate) fn add(messages: &mut Messages) {
    for error in connect_errors() {
        messages.add("ConnectError", error);
    }
    variants!(messages, Untrusted,
        Untrusted::AnotherUser => Untrusted::AnotherUser,
        Untrusted::UnknownUser => Untrusted::UnknownUser,
    );
    messages.add("EndpointError", EndpointError { given: text() });
    tokens_and_certificates(messages);
    protocol(messages);
}

fn tokens_and_certificates(messages: &mut Messages) {
    variants!(messages, TokenError,
        TokenError::Read { .. } => TokenError::Read { path: path(), source: io_error() },
        TokenError::Exposed { .. } => TokenError::Exposed { path: path(), mode: 0o644, chmod: "600" },
        TokenError::TooLarge { .. } => TokenError::TooLarge { path: path() },
        TokenError::Line { .. } => TokenError::Line {
            place: text(), line: 3, problem: "it has no token",
        },
        TokenError::Empty { .. } => TokenError::Empty { place: text() },
        TokenError::TooMany { .. } => TokenError::TooMany { place: text() },
    );
    variants!(messages, SecurityError,
        SecurityError::Unguarded { .. } => SecurityError::Unguarded {
            address: "0.0.0.0:7411".parse().expect("an address"),
            missing: "tokens would be sent in the clear",
        },
        SecurityError::Tokens(_) => SecurityError::Tokens(TokenError::Empty { place: text() }),
        SecurityError::Pem { .. } => SecurityError::Pem { path: path(), source: io_error() },
        SecurityError::Exposed { .. } => SecurityError::Exposed { path: path(), mode: 0o644, chmod: "600" },
        SecurityError::Tls => SecurityError::Tls,
    );
    variants!(messages, AccessError,
        AccessError::Tokens(_) => AccessError::Tokens(TokenError::Empty { place: text() }),
        AccessError::NoToken { .. } => AccessError::NoToken { roles: "worker".to_owned() },
        AccessError::Certificate(_) => AccessError::Certificate(SecurityError::Tls),
        AccessError::Authority { .. } => AccessError::Authority { path: path() },
        AccessError::Host { .. } => AccessError::Host { host: "a_b".to_owned() },
    );
}

fn protocol(messages: &mut Messages) {
    let id = || -> RolloutId { "object/t0/clean/i03".parse().expect("an id") };
    let pair = || "camera+robot".parse::<AxisSet>().expect("a pair");
    let no_design = || DesignError::TooLarge { rows: 1_000_000 };
    messages.add("UnknownName", "purple".parse::<Level>().expect_err("no level"));
    messages.add(
        "UnknownName",
        UnknownName { kind: "axis", given: String::new(), valid: "camera".to_owned() },
    );
    messages.add(
        "NoSuchRow",
        NoSuchRow { id: id(), problem: "there are 50 initial states".to_owned() },
    );
    let refused = libero_ctrl::manifest::parse("{}\n[]\nx").expect_err("no manifest");
    messages.add("ManifestErrors", refused.clone());
    variants!(messages, DesignError,
        DesignError::Empty { .. } => DesignError::Empty {
            field: "tasks", remedy: "name at least one",
        },
        DesignError::Subset { .. } => DesignError::Subset { given: AxisSet::ALL, axes: pair() },
        DesignError::OutOfRange { .. } => DesignError::OutOfRange {
            field: "configs", given: 1_000, valid: "0 to 999".to_owned(),
        },
        DesignError::NoParaphrase { .. } => DesignError::NoParaphrase {
            level: "r2.5".parse().expect("a level"),
        },
        DesignError::Delay { .. } => DesignError::Delay {
            level: "r3".parse().expect("a level"),
        },
        DesignError::NoPlacebo { .. } => DesignError::NoPlacebo { field: "placebo_configs" },
        DesignError::PlaceboRadius { .. } => DesignError::PlaceboRadius { given: 2.0 },
        DesignError::PlaceboConfig { .. } => DesignError::PlaceboConfig { given: 12 },
        DesignError::TooLarge { .. } => no_design(),
    );
    variants!(messages, SpecError,
        SpecError::Json { .. } => {
            libero_ctrl::CampaignSpec::from_json("{}").expect_err("no specification")
        },
        SpecError::Empty { .. } => SpecError::Empty { field: "name", remedy: "write a name" },
        SpecError::Replicates { .. } => SpecError::Replicates { given: 0 },
        SpecError::Endpoint => SpecError::Endpoint,
        SpecError::Assets { .. } => SpecError::Assets { given: text() },
        SpecError::Unmatched { .. } => SpecError::Unmatched { field: "explains" },
        SpecError::Radius { .. } => SpecError::Radius {
            field: "thresholds.tolerance", given: 0.0, valid: [0.01, 100.0],
        },
        SpecError::Execution { .. } => SpecError::Execution {
            given: "hold:2".parse().expect("a model"),
            row_model: "overlap:4".parse().expect("a model"),
        },
        SpecError::Latency { .. } => SpecError::Latency {
            given: "hold:2".parse().expect("a model"),
        },
        SpecError::Stop(_) => SpecError::Stop(StopError::NotSimultaneous),
        SpecError::Variants(_) => SpecError::Variants(VariantsError {
            field: "stop", rollouts: "variants", problem: "leave it out",
        }),
        SpecError::Selection { .. } => SpecError::Selection { problem: text() },
        SpecError::VariantRow { .. } => SpecError::VariantRow { id: id() },
        SpecError::Design(_) => SpecError::Design(no_design()),
        SpecError::SuiteFile(_) => SpecError::SuiteFile(no_suite_file()),
        SpecError::Manifest(_) => SpecError::Manifest(ManifestErrors::clone(&refused)),
    );
    variants!(messages, SuiteFileError,
        SuiteFileError::Json { .. } => no_suite_file(),
        SuiteFileError::Value { .. } => SuiteFileError::Value {
            field: "suites[0].name".to_owned(),
            given: "`A`".to_owned(),
            remedy: "write lower-case letters".to_owned(),
        },
    );
    variants!(messages, StopError,
        StopError::Measure(_) => {
            StopError::Measure("purple".parse::<Level>().expect_err("no level"))
        },
        StopError::NotSimultaneous => StopError::NotSimultaneous,
        StopError::BothKinds => StopError::BothKinds,
        StopError::Strata { .. } => StopError::Strata {
            given: "suites",
            rule: "I excludes 0 for new tasks".to_owned(),
            needed: "whole_tasks",
        },
        StopError::Replicates { .. } => StopError::Replicates { given: 2 },
        StopError::Derived { .. } => StopError::Derived { field: "explains" },
        StopError::Missing { .. } => StopError::Missing { rollout: id() },
    );
    variants!(messages, LineProblem,
        LineProblem::Row(_) => LineProblem::Row("the field `suite` is missing".to_owned()),
        LineProblem::Duplicate { .. } => LineProblem::Duplicate { id: id(), first: 1 },
        LineProblem::Unpaired { .. } => LineProblem::Unpaired {
            id: id(), column: "init_id".to_owned(), first: 2,
        },
        LineProblem::Execution { .. } => LineProblem::Execution {
            id: id(),
            given: "hold:2".parse().expect("a model"),
            expected: "overlap:4".parse().expect("a model"),
            first: 1,
        },
        LineProblem::TooMany => LineProblem::TooMany,
        LineProblem::NoRows => LineProblem::NoRows,
        LineProblem::Radius { .. } => LineProblem::Radius {
            id: id(),
            axis: "camera".parse().expect("an axis"),
            level: "L2".parse().expect("a level"),
            given: 1.0,
            expected: 2.0,
        },
    );
    variants!(messages, PerturbError,
        PerturbError::NotEmpty { .. } => PerturbError::NotEmpty { condition: Condition::Clean },
        PerturbError::OtherAxes { .. } => PerturbError::OtherAxes {
            condition: Condition::of(pair()), given: AxisSet::ALL,
        },
        PerturbError::Parameters { .. } => PerturbError::Parameters {
            condition: Condition::Combination, problem: "the field `x` is missing".to_owned(),
        },
    );
    variants!(messages, RowError,
        RowError::Contradiction { .. } => RowError::Contradiction {
            id: id(), column: "suite", given: text(), expected: "libero_object".to_owned(),
        },
        RowError::InitState { .. } => RowError::InitState { id: id(), given: 50 },
        RowError::Own { .. } => RowError::Own { id: id(), is_given: true },
        RowError::OwnPath { .. } => RowError::OwnPath { id: id(), path: "../a".to_owned() },
        RowError::Protocol { .. } => RowError::Protocol { id: id(), given: None },
        RowError::Placebo { .. } => RowError::Placebo { id: id(), given: None },
        RowError::Latency { .. } => RowError::Latency {
            id: id(),
            given: "hold:2".parse().expect("a model"),
            expected: None,
        },
        RowError::PolicySeed { .. } => RowError::PolicySeed { id: id(), given: 7 },
        RowError::Perturb { .. } => RowError::Perturb {
            id: id(),
            problem: PerturbError::NotEmpty { condition: Condition::Clean },
        },
    );
}

/// Returns every finding at a server's address, for every kind of server.
fn connect_errors() -> Vec<ConnectError> {
    let web = |is_backend_down| ProbeResult::Web {
        answer: "HTTP status 404".to_owned(),
        is_backend_down,
    };
    let mut found = vec![
        ProbeResult::UnknownHost,
        ProbeResult::Nothing,
        ProbeResult::NoAnswer,
        ProbeResult::System(io_error().to_string()),
        ProbeResult::AnotherUser,
        ProbeResult::UnknownUser,
        ProbeResult::Encrypted,
        ProbeResult::Unencrypted,
        ProbeResult::OtherTls("received fatal alert: HandshakeFailure".to_owned()),
        web(false),
        web(true),
        ProbeResult::Ssh,
        ProbeResult::Other { answer: "220 mail".to_owned() },
        ProbeResult::Mute,
        ProbeResult::OtherKind(ServerKind::Policy),
        ProbeResult::OtherGrpc,
        ProbeResult::LacksCall,
        ProbeResult::Broken,
    ];
    for found in &found {
        is_known(found);
    }
    let faults = [
        CertificateFault::Untrusted,
        CertificateFault::Expired { days: 0 },
        CertificateFault::Expired { days: 1 },
        CertificateFault::Expired { days: 400 },
        CertificateFault::NotYetValid,
        CertificateFault::OtherName { names: vec![] },
        CertificateFault::OtherName { names: vec!["a.b".to_owned(), "c.d".to_owned()] },
        CertificateFault::Authority,
        CertificateFault::Unusable("bad encoding".to_owned()),
    ];
    for fault in &faults {
        is_known_fault(fault);
    }
    found.extend(faults.map(ProbeResult::Certificate));
    let kinds =
        [ServerKind::Coordinator, ServerKind::Policy, ServerKind::Openpi, ServerKind::VlaEval];
    let mut connect_errors = vec![];
    for (found, expected) in found.iter().flat_map(|found| kinds.map(|kind| (found, kind))) {
        for has_authority in [false, true] {
            connect_errors.push(ConnectError {
                expected,
                host: "gpu-3".to_owned(),
                found: found.clone(),
                has_authority,
                settings: SETTINGS,
            });
        }
    }
    connect_errors
}

/// Fails to compile once there is a further variant, which the list above needs too.
fn is_known(found: &ProbeResult) {
    match found {
        ProbeResult::UnknownHost
        | ProbeResult::Nothing
        | ProbeResult::NoAnswer
        | ProbeResult::System(_)
        | ProbeResult::AnotherUser
        | ProbeResult::UnknownUser
        | ProbeResult::Encrypted
        | ProbeResult::Unencrypted
        | ProbeResult::Certificate(_)
        | ProbeResult::OtherTls(_)
        | ProbeResult::Web { .. }
        | ProbeResult::Ssh
        | ProbeResult::Other { .. }
        | ProbeResult::Mute
        | ProbeResult::OtherKind(_)
        | ProbeResult::OtherGrpc
        | ProbeResult::LacksCall
        | ProbeResult::Broken => {}
    }
}

fn is_known_fault(fault: &CertificateFault) {
    match fault {
        CertificateFault::Untrusted
        | CertificateFault::Expired { .. }
        | CertificateFault::NotYetValid
        | CertificateFault::OtherName { .. }
        | CertificateFault::Authority
        | CertificateFault::Unusable(_) => {}
    }
}
