//! Maps errors to gRPC statuses, in one place.

use farm_proto::to_status;
use optics_model::Invalid;
use tonic::{Code, Status};

use crate::dispatch::DispatchError;
use crate::farm::FarmError;
use crate::store::StoreError;

impl From<FarmError> for Status {
    fn from(error: FarmError) -> Self {
        let code = match &error {
            FarmError::Invalid(invalid) => return to_status(invalid),
            FarmError::NotFound { .. }
            | FarmError::Deleted { .. }
            | FarmError::NoMeasurement { .. }
            | FarmError::Worker { .. }
            | FarmError::Dispatch(DispatchError::UnknownJob(_)) => Code::NotFound,
            FarmError::NameTaken { .. } => Code::AlreadyExists,
            // Not UNAUTHENTICATED, which is about tokens: the remedy is to register again.
            FarmError::Dispatch(DispatchError::UnknownWorker(_)) => Code::Aborted,
            FarmError::NotYours { .. }
            | FarmError::OthersMeasurement { .. }
            | FarmError::Dispatch(DispatchError::Fenced(_)) => Code::PermissionDenied,
            FarmError::Dispatch(DispatchError::LeaseLost { .. })
            | FarmError::NotComplete { .. }
            | FarmError::WrongState { .. }
            | FarmError::OtherVersion { .. } => Code::FailedPrecondition,
            FarmError::Stopping => Code::Unavailable,
            FarmError::TooLarge { .. }
            | FarmError::Quota(_)
            | FarmError::Store(StoreError::LittleRoom { .. })
            | FarmError::Dispatch(DispatchError::ManyWorkers { .. }) => Code::ResourceExhausted,
            FarmError::Damaged { .. } => Code::DataLoss,
            FarmError::Unreadable { .. } => {
                tracing::error!(%error, "the database gave back something else, or nothing");
                Code::Internal
            }
            FarmError::Broken | FarmError::Defect | FarmError::Backup(_) => Code::Internal,
            FarmError::Store(store) => {
                tracing::error!(error = %store, "the store failed");
                Code::Internal
            }
        };
        Self::new(code, error.to_string())
    }
}

/// Converts the error of a refused value to a status.
pub(super) trait OrStatus<T> {
    fn or_status(self) -> Result<T, Status>;
}

impl<T> OrStatus<T> for Result<T, Invalid> {
    fn or_status(self) -> Result<T, Status> {
        self.map_err(|invalid| to_status(&invalid))
    }
}

/// The value of a required field.
pub(super) fn required<T>(field: &str, value: Option<T>) -> Result<T, Status> {
    value.ok_or_else(|| to_status(&Invalid::new(field, "nothing", "a value is needed")))
}
