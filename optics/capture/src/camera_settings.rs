//! Checks that size, mosaic and exposure are equal in all photographs of a session.

use crate::frame::{Exposure, Pattern, Photo};
use crate::refusal::Refusal;

/// Size, mosaic and exposure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CameraSettings {
    pub width: usize,
    pub height: usize,
    pub pattern: Pattern,
    pub exposure: Option<Exposure>,
}

impl CameraSettings {
    pub fn of(photo: &Photo) -> Self {
        let frame = &photo.frame;
        Self {
            width: frame.width(),
            height: frame.height(),
            pattern: frame.pattern(),
            exposure: photo.exposure,
        }
    }

    /// Refuses a photograph with other settings. Exposures are compared only if both files contain them.
    pub fn check(&self, photo: &Photo) -> Result<(), Refusal> {
        let other = Self::of(photo);
        let mixed = |what, found: String, expected: String| {
            Err(Refusal::Mixed { label: photo.label.clone(), what, found, expected })
        };
        if (self.width, self.height) != (other.width, other.height) {
            let size = |k: &Self| format!("{} × {} px", k.width, k.height);
            return mixed("the frame", size(&other), size(self));
        }
        if self.pattern != other.pattern {
            return mixed("the mosaic", format!("{:?}", other.pattern), format!("{:?}", self.pattern));
        }
        match (other.exposure, self.exposure) {
            (Some(a), Some(b)) if a != b => mixed("the exposure", a.to_string(), b.to_string()),
            _ => Ok(()),
        }
    }
}
