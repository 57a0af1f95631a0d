//! The methods of the coordinator that are called.

/// Every method; an input names one by its place.
pub(super) const METHODS: [&str; 25] = [
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
];

/// Only method whose answer may wait: for a job.
pub(super) const CLAIM: &str = "WorkerService/Claim";
