//! Reads a session's photographs one at a time.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use optics_capture::{Colour, Exposure, Frame, Levels, Pattern, Photo};

use super::bands::BandPixels;
use super::picture::Thumbnail;
use crate::photograph::{self, About, Photograph, SampleLayout};

/// Reads photographs, refuses those that do not belong to the session, and records the others.
#[derive(Debug, Default)]
pub struct Shots {
    /// The pattern of files that do not state one.
    pattern: Option<[Colour; 4]>,
    /// The pixels that record the present band; None for red, green and blue.
    band: Option<BandPixels>,
    /// Folder that labels are relative to.
    folder: PathBuf,
    /// The first camera, and the label of its photograph.
    camera: Option<(String, String)>,
    read: Vec<Input>,
}

/// A photograph that was read.
#[derive(Debug, Clone)]
pub struct Input {
    pub label: String,
    pub digest: String,
    /// Digest of the samples; a copy in another format has the same.
    picture: blake3::Hash,
    /// The subject of the photograph.
    group: String,
    pub about: About,
    /// None of bands: a session of them has many photographs, which all look alike.
    pub thumbnail: Option<Thumbnail>,
}

impl Shots {
    pub fn new(pattern: Option<[Colour; 4]>, folder: &Path) -> Self {
        Self { pattern, folder: folder.to_owned(), ..Self::default() }
    }

    /// The pixels of the photographs that follow.
    pub(super) fn of_band(&mut self, pixels: Option<BandPixels>) {
        self.band = pixels;
    }

    /// Reads the next photograph; photographs of one group show the same subject.
    pub fn read(&mut self, path: &Path, group: &str) -> Result<Photo> {
        let label = path.strip_prefix(&self.folder).unwrap_or(path).display().to_string();
        let (photograph, digest) = photograph::read(path)?;
        self.check_camera(&photograph.about, &label)?;
        let picture = digest_of(&photograph.samples);
        if self.read.iter().any(|input| input.label == label) {
            // Bands share dark shots.
            return self.photo(photograph, &label).with_context(|| format!("photograph {}", path.display()));
        }
        self.check_another(picture, &label)?;
        let about = photograph.about.clone();
        let photo =
            self.photo(photograph, &label).with_context(|| format!("photograph {}", path.display()))?;
        let thumbnail = self.band.is_none().then(|| Thumbnail::of(&photo.frame));
        let (digest, group) = (digest.to_hex().to_string(), group.to_owned());
        self.read.push(Input { label, digest, picture, group, about, thumbnail });
        Ok(photo)
    }

    /// Number of photographs that were read.
    pub(super) fn count(&self) -> usize {
        self.read.len()
    }

    /// The camera and exposure of a photograph.
    pub(super) fn about(&self, index: usize) -> About {
        self.read.get(index).map(|input| input.about.clone()).unwrap_or_default()
    }

    pub fn into_inputs(self) -> Vec<Input> {
        self.read
    }

    fn check_camera(&mut self, about: &About, label: &str) -> Result<()> {
        match (&self.camera, &about.camera) {
            (Some((first, of)), Some(camera)) if first != camera => {
                bail!("{label} was taken with {camera}, {of} with {first}: a session has one camera")
            }
            (None, Some(camera)) => self.camera = Some((camera.clone(), label.to_owned())),
            _ => {}
        }
        Ok(())
    }

    /// Two shots never have the same noise: files with equal samples are one photograph, which would agree with itself.
    fn check_another(&self, picture: blake3::Hash, label: &str) -> Result<()> {
        let same = self.read.iter().find(|input| input.picture == picture);
        same.map_or(Ok(()), |Input { label: other, .. }| {
            bail!("{label} holds the same photograph as {other}, sample by sample: each may be used once")
        })
    }

    fn photo(&self, photograph: Photograph, label: &str) -> Result<Photo> {
        let (pattern, photograph) = match self.band {
            None => (self.mosaic(photograph.layout)?, photograph),
            Some(pixels) => self.one_channel(photograph, pixels)?,
        };
        let Photograph { width, height, samples, black, white, about, .. } = photograph;
        let exposure =
            about.exposure_s.map(|time_s| Exposure { time_s, f_number: about.f_number, iso: about.iso });
        Ok(Photo {
            label: label.to_owned(),
            frame: Frame::new(width, height, pattern, samples)?,
            levels: Levels { black, white },
            seconds: about.taken_s,
            exposure,
        })
    }

    /// The photograph of a band: one channel.
    fn one_channel(&self, photograph: Photograph, pixels: BandPixels) -> Result<(Pattern, Photograph)> {
        let pattern = match (photograph.layout, pixels) {
            (SampleLayout::Mosaic(None), BandPixels::Mono) if self.pattern.is_none() => Pattern::MONOCHROME,
            (SampleLayout::Mosaic(_), BandPixels::Mono) => {
                bail!("it has a mosaic of colours: set `channel` of the band to \"R\", \"G\" or \"B\"")
            }
            (SampleLayout::Mosaic(None), BandPixels::Colour(_)) if self.pattern.is_none() => bail!(
                "the file states no mosaic of colours: leave `channel` of the band out if the camera is monochrome, or set \
                 `pattern` under [camera]"
            ),
            (layout @ SampleLayout::Mosaic(_), BandPixels::Colour(colour)) => {
                let Pattern::Bayer(colours) = self.mosaic(layout)? else { bail!("it is no mosaic") };
                Pattern::only(colours, colour)
            }
            (SampleLayout::Rgb, BandPixels::Mono) => {
                bail!(
                    "it has three colours in each pixel: set `channel` of the band to \"R\", \"G\" or \"B\""
                )
            }
            (SampleLayout::Rgb, BandPixels::Colour(colour)) => {
                return Ok((Pattern::MONOCHROME, plane(photograph, colour.index())));
            }
        };
        Ok((pattern, photograph))
    }

    fn mosaic(&self, layout: SampleLayout) -> Result<Pattern> {
        Ok(match (layout, self.pattern) {
            (SampleLayout::Rgb, None) => Pattern::Rgb,
            (SampleLayout::Mosaic(Some(colours)), None) => Pattern::Bayer(colours),
            (SampleLayout::Mosaic(None), Some(given)) => Pattern::Bayer(given),
            (SampleLayout::Mosaic(Some(colours)), Some(given)) => {
                if colours != given {
                    let [says, given] = [colours, given].map(|p| p.map(Colour::letter).concat());
                    bail!("camera.pattern is {given:?}, but the file says {says:?}: leave it out");
                }
                Pattern::Bayer(given)
            }
            (SampleLayout::Mosaic(None), None) => bail!(
                "the file does not state the colours of its mosaic: set `pattern = \"RGGB\"`, or what the camera has, \
                 under [camera], `--pattern` with --check and --new (`dcraw -i -v` prints it as \"Filter pattern\"); of a \
                 monochrome camera with filters add a [[band]] for each; without, set `pattern = \"mono\"`, which \
                 gives three channels that are one"
            ),
            (SampleLayout::Rgb, Some(_)) => {
                bail!("the file has three colours in each pixel, so camera.pattern must be left out")
            }
        })
    }
}

/// One colour of a photograph with three in each pixel.
fn plane(photograph: Photograph, c: usize) -> Photograph {
    let levels = |of: Option<[f64; 4]>| of.map(|levels| [levels[c]; 4]);
    let samples = photograph.samples.iter().skip(c).step_by(3).copied().collect();
    let (black, white) = (levels(photograph.black), levels(photograph.white));
    Photograph { layout: SampleLayout::Mosaic(None), samples, black, white, ..photograph }
}

/// Warnings about shots whose Orientation differs from that of the first shot of the same subject. Viewers that turn
/// files leave such tags, but so do cameras that look straight down; the agreement of the shots shows whether samples
/// are turned.
pub fn turned(inputs: &[Input]) -> Vec<String> {
    let stated = |input: &Input| input.about.orientation.filter(|o| !o.is_as_stored());
    let name = |input: &Input| input.about.orientation.map_or_else(|| "none".to_owned(), |o| o.to_string());
    let warning = |input: &Input| {
        let first = inputs.iter().find(|other| other.group == input.group)?;
        (stated(first) != stated(input)).then(|| {
            format!(
                "{} has Orientation {}, {} has {}; all are used as stored: if a viewer turned some, take the files as they \
                 left the camera",
                input.label,
                name(input),
                first.label,
                name(first)
            )
        })
    };
    inputs.iter().filter_map(warning).collect()
}

fn digest_of(samples: &[u16]) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    for part in samples.chunks(1 << 16) {
        let bytes: Vec<u8> = part.iter().flat_map(|v| v.to_le_bytes()).collect();
        hasher.update(&bytes);
    }
    hasher.finalize()
}

#[cfg(test)]
mod tests;
