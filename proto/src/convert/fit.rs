//! Measurements, fit options, answers.

use super::required;
use crate::fit::{Candidate, ChannelFit, FitOptions, ThicknessError};
use crate::invalid::{Invalid, Result, each};
use crate::measurement::{MeasuredProfile, Measurement};
use crate::wire;

impl From<&Measurement> for wire::Measurement {
    fn from(measurement: &Measurement) -> Self {
        let profile = |p: &MeasuredProfile| wire::MeasuredProfile {
            channel: p.channel().to_owned(),
            thickness_mm: p.thickness_mm(),
            x_mm: p.x_mm().to_vec(),
            values: p.values().to_vec(),
            std_errors: p.std_errors().unwrap_or_default().to_vec(),
        };
        Self {
            material: measurement.material().to_owned(),
            profiles: measurement.profiles().iter().map(profile).collect(),
        }
    }
}

impl TryFrom<wire::Measurement> for Measurement {
    type Error = Invalid;

    fn try_from(measurement: wire::Measurement) -> Result<Self> {
        let profiles = each("profiles", measurement.profiles, |p| {
            let std_errors = (!p.std_errors.is_empty()).then_some(p.std_errors);
            MeasuredProfile::new(p.channel, p.thickness_mm, p.x_mm, p.values, std_errors)
        })?;
        Self::new(measurement.material, profiles)
    }
}

impl TryFrom<&wire::FitRequest> for FitOptions {
    type Error = Invalid;

    fn try_from(request: &wire::FitRequest) -> Result<Self> {
        let default = Self::default();
        Self::new(
            request.lambda.unwrap_or(default.lambda()),
            request.mu.unwrap_or(default.mu()),
            request.g,
            request.top.unwrap_or(default.top() as u32),
        )
    }
}

impl From<ChannelFit> for wire::ChannelFit {
    fn from(fit: ChannelFit) -> Self {
        Self { channel: fit.channel, candidates: fit.candidates.into_iter().map(Into::into).collect() }
    }
}

impl TryFrom<wire::ChannelFit> for ChannelFit {
    type Error = Invalid;

    fn try_from(fit: wire::ChannelFit) -> Result<Self> {
        let candidates = each("candidates", fit.candidates, Candidate::try_from)?;
        Ok(Self { channel: fit.channel, candidates })
    }
}

impl From<Candidate> for wire::Candidate {
    fn from(candidate: Candidate) -> Self {
        let term = |t: ThicknessError| wire::ThicknessError {
            thickness_mm: t.thickness_mm,
            value_rms: t.value_rms,
            gradient_rms: t.gradient_rms,
            record: t.record as u32,
        };
        Self {
            medium: Some(candidate.medium.into()),
            sample_ior: candidate.sample_ior,
            error: candidate.error,
            thicknesses: candidate.thicknesses.into_iter().map(term).collect(),
        }
    }
}

impl TryFrom<wire::Candidate> for Candidate {
    type Error = Invalid;

    fn try_from(candidate: wire::Candidate) -> Result<Self> {
        let term = |t: wire::ThicknessError| ThicknessError {
            thickness_mm: t.thickness_mm,
            value_rms: t.value_rms,
            gradient_rms: t.gradient_rms,
            record: t.record as usize,
        };
        Ok(Self {
            medium: required("medium", candidate.medium)?.try_into()?,
            sample_ior: candidate.sample_ior,
            error: candidate.error,
            thicknesses: candidate.thicknesses.into_iter().map(term).collect(),
        })
    }
}
