//! What a slab looks like by a dictionary.

use super::required;
use crate::wire;
use optics_model::fit::{PredictedChannel, PredictedProfiles, ProfileQuestion};
use optics_model::invalid::{Invalid, Result};
use optics_model::medium::Medium;

impl TryFrom<wire::ProfileRequest> for ProfileQuestion {
    type Error = Invalid;

    fn try_from(request: wire::ProfileRequest) -> Result<Self> {
        let medium = Medium::try_from(required("medium", request.medium)?).map_err(|e| e.within("medium"))?;
        Self::new(medium, request.thickness_mm, request.sample_ior, request.channels)
    }
}

impl From<&ProfileQuestion> for wire::ProfileRequest {
    /// The dictionary is not part of the question.
    fn from(question: &ProfileQuestion) -> Self {
        Self {
            dictionary: String::new(),
            medium: Some((*question.medium()).into()),
            thickness_mm: question.thickness_mm(),
            sample_ior: question.sample_ior(),
            channels: question.channels().to_vec(),
        }
    }
}

impl From<PredictedProfiles> for wire::ProfileResponse {
    fn from(profiles: PredictedProfiles) -> Self {
        Self {
            medium: Some(profiles.medium.into()),
            thickness_mm: profiles.thickness_mm,
            sample_ior: profiles.sample_ior,
            recorded: profiles.recorded,
            pixels: Some(profiles.pixels.into()),
            channels: profiles.channels.into_iter().map(Into::into).collect(),
        }
    }
}

impl TryFrom<wire::ProfileResponse> for PredictedProfiles {
    type Error = Invalid;

    fn try_from(profiles: wire::ProfileResponse) -> Result<Self> {
        Ok(Self {
            medium: required("medium", profiles.medium)?.try_into()?,
            thickness_mm: profiles.thickness_mm,
            sample_ior: profiles.sample_ior,
            recorded: profiles.recorded,
            pixels: required("pixels", profiles.pixels)?.try_into()?,
            channels: profiles.channels.into_iter().map(Into::into).collect(),
        })
    }
}

impl From<PredictedChannel> for wire::PredictedChannel {
    fn from(channel: PredictedChannel) -> Self {
        Self {
            channel: channel.channel,
            values: channel.values,
            std_errors: channel.std_errors.unwrap_or_default(),
            gradient: channel.gradient,
        }
    }
}

impl From<wire::PredictedChannel> for PredictedChannel {
    fn from(channel: wire::PredictedChannel) -> Self {
        Self {
            channel: channel.channel,
            values: channel.values,
            std_errors: (!channel.std_errors.is_empty()).then_some(channel.std_errors),
            gradient: channel.gradient,
        }
    }
}
