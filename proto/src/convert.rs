//! Converts between the wire and the model, in one place. Incoming messages pass a validating constructor; outgoing
//! values use a plain `From`.

mod design;
mod fit;
mod lease;
mod likelihood;
mod measurement;
mod mirror;
mod mixtures;
mod model;
mod profile;
mod scale;
mod shared_errors;
mod status;
mod text;

pub use measurement::check_pixels;
pub use mixtures::mixtures;
use optics_model::Invalid;
pub use text::is_printable;
pub(crate) use text::{check_text, shortened};
use tonic_types::{ErrorDetails, StatusExt};

/// A refusal as status `INVALID_ARGUMENT`, with a `google.rpc.BadRequest` that names the field.
pub fn to_status(invalid: &Invalid) -> tonic::Status {
    let why = format!("{} is not valid: {}", invalid.given(), invalid.allowed());
    let details = ErrorDetails::with_bad_request_violation(invalid.field(), why);
    tonic::Status::with_error_details(tonic::Code::InvalidArgument, invalid.to_string(), details)
}
