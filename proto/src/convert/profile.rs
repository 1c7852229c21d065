//! Converts questions for the predicted profiles of a slab, and their answers.

use super::mirror::{absent_if_empty, mirror, required};
use crate::wire;
use optics_model::fit::{PixelRow, PredictedChannel, PredictedProfiles, ProfileQuestion};
use optics_model::invalid::{Invalid, Result, each};
use optics_model::medium::Medium;

impl TryFrom<wire::ProfileRequest> for ProfileQuestion {
    type Error = Invalid;

    fn try_from(request: wire::ProfileRequest) -> Result<Self> {
        let medium = Medium::try_from(required("medium", request.medium)?).map_err(|e| e.within("medium"))?;
        Self::new(medium, request.thickness_mm, request.sample_ior, request.channels)
    }
}

impl From<&ProfileQuestion> for wire::ProfileRequest {
    /// Dictionary and board are not part of the question.
    fn from(question: &ProfileQuestion) -> Self {
        Self {
            dictionary: String::new(),
            medium: Some((*question.medium()).into()),
            thickness_mm: question.thickness_mm(),
            sample_ior: question.sample_ior(),
            channels: question.channels().to_vec(),
            board: Vec::new(),
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
        let pixels = PixelRow::try_from(required("pixels", profiles.pixels)?)?;
        let whole = |channel| checked(channel, pixels.count());
        Ok(Self {
            medium: required("medium", profiles.medium)?.try_into()?,
            thickness_mm: profiles.thickness_mm,
            sample_ior: profiles.sample_ior,
            recorded: profiles.recorded,
            pixels,
            channels: each("channels", profiles.channels, whole)?,
        })
    }
}

mirror!(PredictedChannel { channel, values, std_errors: absent_if_empty, gradient });

/// Checks that a channel has a number for each pixel.
fn checked(channel: wire::PredictedChannel, pixels: usize) -> Result<PredictedChannel> {
    let channel = PredictedChannel::try_from(channel)?;
    let lengths = [("values", channel.values.len()), ("gradient", channel.gradient.len())];
    let of_errors = channel.std_errors.as_ref().map(|errors| ("std_errors", errors.len()));
    if let Some((field, given)) = lengths.into_iter().chain(of_errors).find(|(_, given)| *given != pixels) {
        return Err(Invalid::new(
            field,
            format_args!("{given} numbers"),
            format!("{pixels} pixels have one each"),
        ));
    }
    Ok(channel)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An answer must have a number for each pixel.
    #[test]
    fn answer_has_a_number_per_pixel() {
        let answer = |errors: usize, gradient: usize| {
            let channel = PredictedChannel {
                channel: "R".to_owned(),
                values: vec![0.5; 16],
                std_errors: (errors > 0).then(|| vec![0.1; errors]),
                gradient: vec![0.0; gradient],
            };
            let medium = Medium::new(6.0, 0.99, 0.4).unwrap();
            let pixels = PixelRow::new(-4.0, 4.0, 0.5).unwrap();
            let channels = vec![channel];
            let (thickness_mm, sample_ior) = (0.5, 1.5);
            PredictedProfiles { medium, thickness_mm, sample_ior, recorded: true, pixels, channels }
        };
        for errors in [0, 16] {
            let whole = answer(errors, 16);
            assert_eq!(PredictedProfiles::try_from(wire::ProfileResponse::from(whole.clone())), Ok(whole));
        }
        for (errors, gradient, field) in [(15, 16, "channels[0].std_errors"), (0, 17, "channels[0].gradient")]
        {
            let refused = PredictedProfiles::try_from(wire::ProfileResponse::from(answer(errors, gradient)));
            assert_eq!(refused.unwrap_err().field(), field);
        }
    }
}
