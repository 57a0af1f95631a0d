//! Methods of the coordinator under test.

/// All methods; an input selects one by its index.
pub(super) const METHODS: [&str; 26] = [
    "WorkerService/Register",
    CLAIM,
    "WorkerService/Heartbeat",
    "WorkerService/Commit",
    "WorkerService/Release",
    "WorkerService/PutArtifact",
    "WorkerService/NextFilm",
    "OperatorService/CreateCampaign",
    "OperatorService/ListCampaigns",
    "OperatorService/GetCampaign",
    "OperatorService/ChangeCampaign",
    "OperatorService/DeleteCampaign",
    "OperatorService/ListJobs",
    "OperatorService/GetJob",
    "OperatorService/RetryJobs",
    "OperatorService/ListWorkers",
    "OperatorService/Backup",
    "OperatorService/Report",
    "OperatorService/Export",
    "OperatorService/AlterCampaign",
    "OperatorService/Forecast",
    "WorkerService/SignOff",
    "OperatorService/ArchiveCampaign",
    "OperatorService/ImportCampaign",
    "OperatorService/SkipJobs",
    "OperatorService/AppendRows",
];

/// The only method that may wait before it answers, namely for a job.
pub(super) const CLAIM: &str = "WorkerService/Claim";
