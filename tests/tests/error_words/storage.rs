//! Errors of the job table, of reports, and of the coordinator.

use std::sync::Arc;

use adaptive::subsets::{IncompleteLattice, LatticeError, Unexplained};
use coordinator::ServeError;
use coordinator::archive::ArchiveError;
use coordinator::client::ClientError;
use coordinator::reading::ReadError;
use coordinator::storage::StorageError;
use libero_ctrl::{Axis, AxisSet, NotMeasurable, RolloutId, SpecError, Suite};
use libero_family::SelectionError;
use libero_family::protocol::Protocol;
use paired::{DuplicateRecord, NotInOrder, Transition};
use queue::expand::ExpandError;
use queue::ids::{CampaignName, JobId, JobName, NameError, WorkerId};
use queue::invariants::CheckError;
use queue::{
    AdoptError, ArtifactError, CopyError, OpenError, PortableError, QueueError, RowProblem,
    RowsError, StoreError, WorkerProblem,
};
use report::{
    BadLine, BudgetTooSmall, DocumentError, FamilyComparisonError, FamilyError, ImportError,
    NoCommonOrder, NoInteractions, TableError, Unpairable,
};
use transport::{
    AccessError, ConnectError, EndpointError, ProbeResult, SecurityError, ServerKind, Settings,
};

use crate::{Messages, io_error, json_error, path, text, variants};

pub(crate) fn add(messages: &mut Messages) {
    names_and_files(messages);
    queue(messages);
    moving(messages);
    reports(messages);
    coordinator(messages);
}

fn store_error() -> StoreError {
    StoreError::Statement { doing: "commit results", source: Arc::new(sqlx::Error::WorkerCrashed) }
}

fn campaign() -> CampaignName {
    CampaignName::parse("first").expect("a name")
}

fn names_and_files(messages: &mut Messages) {
    variants!(messages, StoreError,
        StoreError::Statement { .. } => store_error(),
        StoreError::Gone { .. } => StoreError::Gone { folder: path() },
    );
    variants!(messages, NameError,
        NameError::Campaign { .. } => CampaignName::parse("a b").expect_err("no name"),
        NameError::Worker { .. } => WorkerId::parse("a b").expect_err("no id"),
    );
    variants!(messages, OpenError,
        OpenError::Folder { .. } => OpenError::Folder { folder: path(), source: io_error() },
        OpenError::InUse { .. } => OpenError::InUse { folder: path() },
        OpenError::NewerSchema { .. } => OpenError::NewerSchema {
            path: path(), found: 9, known: 8, program: "0.1.0",
        },
        OpenError::OlderCheckout { .. } => OpenError::OlderCheckout { path: path() },
        OpenError::Migrate { .. } => OpenError::Migrate {
            path: path(), known: 8, source: sqlx::migrate::MigrateError::VersionMissing(3),
        },
        OpenError::Database { .. } => OpenError::Database {
            path: path(), source: sqlx::Error::WorkerCrashed,
        },
    );
    variants!(messages, CheckError,
        CheckError::Missing { .. } => CheckError::Missing { path: path() },
        CheckError::Read { .. } => CheckError::Read {
            path: path(), source: sqlx::Error::WorkerCrashed,
        },
        CheckError::OtherSchema { .. } => CheckError::OtherSchema {
            path: path(), found: 9, known: 8,
        },
    );
}

fn queue(messages: &mut Messages) {
    let worker = || -> WorkerId { WorkerId::parse("rack-1").expect("an id") };
    let attempt = || rollout_types::AttemptId::from_random([7; 16]);
    let job = || JobName { rollout_id: "object/t0/clean/i03".to_owned(), replicate: 1 };
    variants!(messages, QueueError,
        QueueError::UnknownWorker { .. } => QueueError::UnknownWorker { worker: worker() },
        QueueError::WorkerStopped { .. } => QueueError::WorkerStopped {
            worker: worker(), reason: "it failed too often".to_owned(),
        },
        QueueError::UnknownAttempt { .. } => QueueError::UnknownAttempt { attempt: attempt() },
        QueueError::UnknownCampaign { .. } => QueueError::UnknownCampaign { campaign: campaign() },
        QueueError::Renamed { .. } => QueueError::Renamed { campaign: campaign(), now: campaign() },
        QueueError::NameTaken { .. } => QueueError::NameTaken {
            campaign: campaign(), taken: campaign(),
        },
        QueueError::PolicyMeasured { .. } => QueueError::PolicyMeasured {
            campaign: campaign(), policy: "oft".to_owned(), results: 7,
        },
        QueueError::Unspecified { .. } => QueueError::Unspecified {
            campaign: campaign(), problem: "`replicates` is 0, valid are 1 to 100".to_owned(),
        },
        QueueError::CampaignDiffers { .. } => QueueError::CampaignDiffers {
            campaign: campaign(), differs: "`tasks`".to_owned(),
        },
        QueueError::Cancelled { .. } => QueueError::Cancelled { campaign: campaign() },
        QueueError::Stopped { .. } => QueueError::Stopped { campaign: campaign() },
        QueueError::CampaignInUse { .. } => QueueError::CampaignInUse {
            campaign: campaign(), leased: 1,
        },
        QueueError::HasDerived { .. } => QueueError::HasDerived {
            campaign: campaign(), derived: campaign(),
        },
        QueueError::NoThresholds { .. } => QueueError::NoThresholds {
            campaign: campaign(), problem: NotMeasurable::NoNominal,
        },
        QueueError::Unmatched { .. } => QueueError::Unmatched { campaign: campaign() },
        QueueError::OtherPolicy { .. } => QueueError::OtherPolicy {
            campaign: campaign(), policy: text(), endpoint: text(),
        },
        QueueError::UnknownRollout { .. } => QueueError::UnknownRollout {
            campaign: campaign(), job: job(),
        },
        QueueError::NotQuarantined { .. } => QueueError::NotQuarantined {
            job: job(), state: "leased".to_owned(),
        },
        QueueError::NotSkippable { .. } => QueueError::NotSkippable {
            job: job(), state: "committed".to_owned(),
        },
        QueueError::BackupInHand => QueueError::BackupInHand,
        QueueError::ShuttingDown => QueueError::ShuttingDown,
        QueueError::Store(_) => QueueError::Store(store_error()),
    );
    variants!(messages, ArtifactError,
        ArtifactError::TooLarge { .. } => ArtifactError::TooLarge { attempt: attempt() },
        ArtifactError::NoOutcome { .. } => ArtifactError::NoOutcome { attempt: attempt() },
        ArtifactError::Write { .. } => ArtifactError::Write { path: path(), source: io_error() },
        ArtifactError::Store(_) => ArtifactError::Store(store_error()),
    );
    variants!(messages, ExpandError,
        ExpandError::Spec(_) => ExpandError::Spec(SpecError::Replicates { given: 0 }),
        ExpandError::Name(_) => ExpandError::Name(NameError::Campaign { name: text() }),
        ExpandError::Json(_) => ExpandError::Json(json_error()),
    );
}

fn moving(messages: &mut Messages) {
    let portable = || PortableError::NotOne { count: 0 };
    variants!(messages, PortableError,
        PortableError::Open(_) => PortableError::Open(OpenError::InUse { folder: path() }),
        PortableError::Store(_) => PortableError::Store(store_error()),
        PortableError::NotOne { .. } => portable(),
        PortableError::SpecDigest { .. } => PortableError::SpecDigest { campaign: campaign() },
        PortableError::Violated { .. } => PortableError::Violated {
            invariant: "file_is_whole", example: text(),
        },
        PortableError::Rows(_) => PortableError::Rows(RowsError::Expansion {
            found: 12, expected: 13,
        }),
    );
    let job = JobId(7);
    let id = || NameError::Worker { id: "a b".to_owned() };
    variants!(messages, RowsError,
        RowsError::Specification(_) => RowsError::Specification(SpecError::Replicates { given: 0 }),
        RowsError::Expansion { .. } => RowsError::Expansion { found: 12, expected: 13 },
        RowsError::Row { .. } => RowsError::Row { job, problem: RowProblem::Unspecified },
        RowsError::Worker(_) => RowsError::Worker(id().into()),
    );
    variants!(messages, RowProblem,
        RowProblem::Unreadable { .. } => RowProblem::Unreadable { problem: text() },
        RowProblem::Column { .. } => RowProblem::Column { column: "task" },
        RowProblem::Unspecified => RowProblem::Unspecified,
        RowProblem::Altered { .. } => RowProblem::Altered { column: "max_steps".to_owned() },
        RowProblem::Realised { .. } => RowProblem::Realised { problem: text() },
    );
    variants!(messages, WorkerProblem,
        WorkerProblem::Id(_) => WorkerProblem::Id(id()),
        WorkerProblem::Count { .. } => WorkerProblem::Count {
            worker: WorkerId("a".to_owned()), column: "slots", given: 0,
        },
    );
    variants!(messages, CopyError,
        CopyError::Queue(_) => CopyError::Queue(QueueError::ShuttingDown),
        CopyError::Portable(_) => CopyError::Portable(portable()),
    );
    variants!(messages, AdoptError,
        AdoptError::Exists { .. } => AdoptError::Exists { campaign: campaign() },
        AdoptError::NoSource { .. } => AdoptError::NoSource {
            campaign: campaign(), source_campaign: campaign(),
        },
        AdoptError::OtherSource { .. } => AdoptError::OtherSource {
            campaign: campaign(), source_campaign: campaign(),
        },
        AdoptError::OtherBudgets { .. } => AdoptError::OtherBudgets { campaign: campaign() },
        AdoptError::Ahead { .. } => AdoptError::Ahead { campaign: campaign(), seconds: 90_000 },
        AdoptError::Film { .. } => AdoptError::Film { path: path(), source: io_error() },
        AdoptError::Queue(_) => AdoptError::Queue(QueueError::ShuttingDown),
    );
    variants!(messages, StorageError,
        StorageError::Location { .. } => StorageError::Location { location: text() },
        StorageError::Folder { .. } => StorageError::Folder { path: path(), source: io_error() },
        StorageError::Remote { .. } => StorageError::Remote {
            verb: "store", key: text(), location: "s3://films".to_owned(), problem: text(),
        },
        StorageError::File { .. } => StorageError::File { path: path(), source: io_error() },
    );
    let archive = || "first.tar.gz".to_owned();
    let member = || "report.json".to_owned();
    variants!(messages, ArchiveError,
        ArchiveError::Read { .. } => ArchiveError::Read { archive: archive(), source: io_error() },
        ArchiveError::Foreign { .. } => ArchiveError::Foreign {
            archive: archive(), problem: "it is not a compressed tar archive".to_owned(),
        },
        ArchiveError::OtherVersion { .. } => ArchiveError::OtherVersion {
            archive: archive(), program: text(), what: "format", found: 2, known: 1,
        },
        ArchiveError::Damaged { .. } => ArchiveError::Damaged {
            archive: archive(), member: member(),
        },
        ArchiveError::Altered { .. } => ArchiveError::Altered {
            archive: archive(), member: member(), problem: "it has 3 bytes instead of 5".to_owned(),
        },
        ArchiveError::Content { .. } => ArchiveError::Content {
            archive: archive(), member: "coordinator.sqlite", source: Box::new(portable()),
        },
        ArchiveError::Differs { .. } => ArchiveError::Differs {
            archive: archive(), member: "report.json", place: ".warnings[0]".to_owned(),
            program: text(),
        },
        ArchiveError::Results(_) => ArchiveError::Results(QueueError::ShuttingDown.into()),
        ArchiveError::Report(_) => ArchiveError::Report(DocumentError::Json(json_error())),
        ArchiveError::Json { .. } => ArchiveError::Json {
            member: "provenance.json", source: json_error(),
        },
        ArchiveError::Write { .. } => ArchiveError::Write { path: path(), source: io_error() },
        ArchiveError::Input { .. } => ArchiveError::Input { path: path(), source: io_error() },
        ArchiveError::NoRoom { .. } => ArchiveError::NoRoom {
            archive: archive(), folder: path(), needed_mib: 300, free_mib: 20,
        },
        ArchiveError::Panicked { .. } => ArchiveError::Panicked { archive: archive() },
    );
}

fn reports(messages: &mut Messages) {
    let id: RolloutId = "object/t0/clean/i03".parse().expect("an id");
    let twice = DuplicateRecord { id, replicate: 0 };
    messages.add("DuplicateRecord", twice);
    let axes = AxisSet::ALL;
    messages.add("NotInOrder", NotInOrder { unit: text(), units: 400 });
    messages.add("IncompleteLattice", IncompleteLattice { full: axes, set: axes });
    variants!(messages, LatticeError,
        LatticeError::TooFewAxes(_) => LatticeError::TooFewAxes(AxisSet::of(Axis::Camera)),
        LatticeError::OtherAxes { .. } => LatticeError::OtherAxes { set: axes, full: axes },
        LatticeError::Duplicate(_) => LatticeError::Duplicate(DuplicateRecord {
            id, replicate: 0,
        }),
        LatticeError::TooFewRepeats { .. } => LatticeError::TooFewRepeats {
            axes: 6,
            repeats: 8,
            fewest: 12,
        },
    );
    variants!(messages, NoInteractions,
        NoInteractions::Axes(_) => {
            NoInteractions::Axes(LatticeError::TooFewAxes(AxisSet::of(Axis::Camera)))
        },
        NoInteractions::Empty(_) => NoInteractions::Empty(text()),
        NoInteractions::Incomplete { .. } => NoInteractions::Incomplete {
            campaign: text(), configurations: 12, first: id,
            gap: IncompleteLattice { full: axes, set: axes },
        },
    );
    messages.add("BudgetTooSmall", BudgetTooSmall { budget: 3, most: 42 });
    variants!(messages, NotMeasurable,
        NotMeasurable::NoDesign => NotMeasurable::NoDesign,
        NotMeasurable::NoNominal => NotMeasurable::NoNominal,
        NotMeasurable::NoCondition => NotMeasurable::NoCondition,
        NotMeasurable::ConditionNotRun { .. } => NotMeasurable::ConditionNotRun {
            given: "sensor", valid: "camera, robot".to_owned(),
        },
    );
    variants!(messages, Unexplained,
        Unexplained::Incomplete => Unexplained::Incomplete,
        Unexplained::Unchanged(_) => Unexplained::Unchanged(Transition::StillFails),
        Unexplained::NominalFails => Unexplained::NominalFails,
        Unexplained::AwaitsRepeats => Unexplained::AwaitsRepeats,
        Unexplained::NotConfirmed => Unexplained::NotConfirmed,
    );
    variants!(messages, FamilyError,
        FamilyError::Rollout { .. } => FamilyError::Rollout {
            campaign: text(), source: SelectionError::Nothing,
        },
        FamilyError::Protocol { .. } => FamilyError::Protocol {
            campaign: text(),
            source: "plus".parse::<Protocol>().expect_err("no protocol"),
        },
    );
    variants!(messages, FamilyComparisonError,
        FamilyComparisonError::Family(_) => FamilyComparisonError::Family(FamilyError::Rollout {
            campaign: text(),
            source: SelectionError::Nothing,
        }),
        FamilyComparisonError::Unpairable(_) => FamilyComparisonError::Unpairable(Unpairable {
            a: text(), b: text(), reasons: vec![text()],
        }),
    );
    variants!(messages, DocumentError,
        DocumentError::Duplicate { .. } => DocumentError::Duplicate {
            policy: text(), source: twice,
        },
        DocumentError::Family(_) => DocumentError::Family(FamilyError::Rollout {
            campaign: text(),
            source: SelectionError::Nothing,
        }),
        DocumentError::Pooled { .. } => DocumentError::Pooled { policy: text() },
        DocumentError::Json(_) => DocumentError::Json(json_error()),
    );
    messages.add(
        "Unpairable",
        Unpairable {
            a: "first".to_owned(),
            b: "again".to_owned(),
            reasons: vec!["no rollout is in both".to_owned()],
        },
    );
    variants!(messages, NoCommonOrder,
        NoCommonOrder::NotDrawn { .. } => NoCommonOrder::NotDrawn { subject: text() },
        NoCommonOrder::Differ { .. } => NoCommonOrder::Differ {
            a: "first".to_owned(),
            order_a: "seed 1 in rounds of suites".to_owned(),
            b: "again".to_owned(),
            order_b: "seed 2 in rounds of tasks".to_owned(),
        },
        NoCommonOrder::Configurations { .. } => NoCommonOrder::Configurations {
            a: "first".to_owned(), b: "again".to_owned(),
        },
    );
    variants!(messages, TableError,
        TableError::Csv(_) => TableError::Csv(io_error().into()),
        TableError::Parquet(_) => TableError::Parquet(io_error().into()),
        TableError::Flush(_) => TableError::Flush(io_error()),
    );
    variants!(messages, ImportError,
        ImportError::Read { .. } => ImportError::Read { path: path(), source: io_error() },
        ImportError::Lines { .. } => ImportError::Lines {
            path: path(),
            bad: 1,
            named: vec![BadLine { number: 1, reason: json_error().to_string() }],
        },
        ImportError::TooLong { .. } => ImportError::TooLong { path: path() },
        ImportError::TooLarge { .. } => ImportError::TooLarge { path: path() },
        ImportError::Empty { .. } => ImportError::Empty { path: path() },
        ImportError::About { .. } => ImportError::About { path: path(), source: json_error() },
    );
}

fn coordinator(messages: &mut Messages) {
    variants!(messages, ReadError,
        ReadError::Queue(_) => ReadError::Queue(QueueError::ShuttingDown),
        ReadError::Spec { .. } => ReadError::Spec {
            campaign: campaign(), source: SpecError::Replicates { given: 0 },
        },
        ReadError::Name(_) => ReadError::Name(
            "x".parse::<libero_ctrl::Level>().expect_err("no level"),
        ),
        ReadError::Row { .. } => ReadError::Row { rollout_id: text(), source: json_error() },
    );
    variants!(messages, ServeError,
        ServeError::Open(_) => ServeError::Open(OpenError::InUse { folder: path() }),
        ServeError::Store(_) => ServeError::Store(store_error()),
        ServeError::Socket { .. } => ServeError::Socket { problem: io_error().to_string() },
        ServeError::Security(_) => ServeError::Security(SecurityError::Tls),
        ServeError::Panicked { .. } => ServeError::Panicked { what: "the database's writer" },
        ServeError::Tidy { .. } => ServeError::Tidy { folder: path(), source: io_error() },
    );
    variants!(messages, ClientError,
        ClientError::Url(_) => ClientError::Url(EndpointError { given: text() }),
        ClientError::Access(_) => ClientError::Access(AccessError::Host { host: text() }),
        ClientError::Unreachable { .. } => ClientError::Unreachable {
            url: "http://h:1".to_owned(),
            trouble: Box::new(ConnectError {
                expected: ServerKind::Coordinator,
                host: "h".to_owned(),
                found: ProbeResult::Nothing,
                has_authority: false,
                settings: Settings {
                    address: "--connect",
                    authority: "--ca",
                    clear: "http://",
                    encrypted: "https://",
                },
            }),
        },
        ClientError::Invalid { .. } => ClientError::Invalid { message: "find `x`".to_owned() },
        ClientError::Refused { .. } => ClientError::Refused { message: "find `x`".to_owned() },
    );
}
