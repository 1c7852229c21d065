//! Reads from the EXIF 2.3 tags how a photograph was taken.

use std::fmt;

use super::directory::{Bytes, Directory, Tag};

/// Exposure, time and orientation of a photograph, as far as its file states them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct About {
    pub camera: Option<String>,
    pub exposure_s: Option<f64>,
    pub iso: Option<f64>,
    pub f_number: Option<f64>,
    /// Time of the shot in seconds, by the camera's clock.
    pub taken_s: Option<f64>,
    /// How viewers should turn the picture.
    pub orientation: Option<Orientation>,
}

/// How viewers should turn a picture: 1 as it is stored, 3, 6 and 8 turned, others mirrored (TIFF 6.0, Sec. 8). Samples
/// are used as they are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Orientation(u8);

impl Orientation {
    fn new(value: u64) -> Option<Self> {
        (1..=8).contains(&value).then_some(Self(value as u8))
    }

    pub fn number(self) -> u8 {
        self.0
    }

    pub fn is_as_stored(self) -> bool {
        self.0 == 1
    }
}

impl fmt::Display for Orientation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let means = match self.0 {
            1 => "as stored",
            3 => "turned by 180°",
            6 => "turned by 90° clockwise",
            8 => "turned by 90° counterclockwise",
            _ => "mirrored",
        };
        write!(f, "{} ({means})", self.0)
    }
}

impl About {
    /// Reads the directories of a file; the first with a value wins. The orientation is that of the picture's directory
    /// first.
    pub(super) fn of(bytes: Bytes, picture: &Directory, directories: &[Directory]) -> Self {
        let exif = directories.iter().filter_map(|d| {
            let at = d.whole_of(Tag::EXIF).ok()??;
            Directory::read(bytes, at).ok()
        });
        let exif: Vec<Directory> = exif.collect();
        let all = || exif.iter().chain(directories);
        // Invalid numbers count as absent.
        let positive = |tag: Tag| all().find_map(|d| d.number_of(tag).ok().flatten().filter(|v| *v > 0.0));
        let text = |tag: Tag| all().find_map(|d| d.text(tag));
        let orientation = [Some(picture), directories.first()].into_iter().flatten();
        let mut orientation = orientation.filter_map(|d| d.whole_of(Tag::ORIENTATION).ok().flatten());
        let taken = text(Tag::DATE_TIME_ORIGINAL).or_else(|| text(Tag::DATE_TIME));
        let fraction = text(Tag::SUBSEC_ORIGINAL).and_then(|digits| format!("0.{digits}").parse().ok());
        let camera = match (text(Tag::MAKE), text(Tag::MODEL)) {
            (Some(make), Some(model)) if !model.starts_with(&make) => Some(format!("{make} {model}")),
            (_, Some(model)) => Some(model),
            (make, None) => make,
        };
        Self {
            camera,
            exposure_s: positive(Tag::EXPOSURE_TIME),
            iso: positive(Tag::ISO),
            f_number: positive(Tag::F_NUMBER),
            taken_s: taken.and_then(|t| seconds(&t)).map(|s| s + fraction.unwrap_or(0.0)),
            orientation: orientation.find_map(Orientation::new),
        }
    }

    /// Reads EXIF data that another format embeds.
    pub(super) fn of_exif(exif: &[u8]) -> Self {
        let read = || {
            let bytes = Bytes::new(exif)?;
            Some((bytes, Directory::read(bytes, bytes.first().ok()?).ok()?))
        };
        read().map_or_else(Self::default, |(bytes, directory)| {
            Self::of(bytes, &directory, std::slice::from_ref(&directory))
        })
    }
}

/// Seconds since 1970 of "2026:11:21 09:30:00", in an unknown time zone.
fn seconds(text: &str) -> Option<f64> {
    let time = jiff::civil::DateTime::strptime("%Y:%m:%d %H:%M:%S", text).ok()?;
    let zoned = time.to_zoned(jiff::tz::TimeZone::UTC).ok()?;
    Some(zoned.timestamp().as_second() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The times in files of cameras are read.
    #[test]
    fn camera_times_are_read() {
        assert_eq!(seconds("1970:01:02 00:00:01"), Some(86_401.0));
        assert_eq!(seconds("0000:00:00 00:00:00"), None);
        assert_eq!(seconds("yesterday"), None);
    }
}
