//! Decodes TIFF and DNG: selects the photograph among a file's pictures, and reads its tags (TIFF 6.0, TIFF/EP, DNG
//! 1.4).

use optics_capture::Colour;

use super::chunks::Chunks;
use super::directory::{Bytes, Directory, Tag};
use super::icc::tone_curve;
use super::masked::{self, within};
use super::unreadable::UnreadablePhotograph;
use super::{About, MOST_DIRECTORIES, Photograph, SampleLayout};

/// PhotometricInterpretation of a mosaic, and of a demosaiced picture without a tone curve.
const CFA: u64 = 32_803;
const LINEAR_RAW: u64 = 34_892;

pub(super) fn is_tiff(bytes: &[u8]) -> bool {
    Bytes::new(bytes).is_some()
}

pub(super) fn decode(bytes: &[u8]) -> Result<Photograph, UnreadablePhotograph> {
    let bytes = Bytes::new(bytes).ok_or(UnreadablePhotograph::UnknownFormat)?;
    let directories = directories(bytes)?;
    let is_dng = directories.iter().any(|d| d.has(Tag::DNG_VERSION));
    let picture = photograph_of(&directories, is_dng)?;
    let bits = bits(picture)?;
    let count = pictures(&directories, picture);
    if count > 1 {
        return Err(UnreadablePhotograph::Pictures { count });
    }
    let layout = layout(picture)?;
    if let Some(seen) = not_linear(picture) {
        return Err(UnreadablePhotograph::NotLinear { seen });
    }
    check_meaning(picture)?;
    let chunks = Chunks::new(bytes, picture, layout.samples_per_pixel(), bits)?;
    let (width, height) = (chunks.width(), chunks.height());
    let mut samples = chunks.read()?;
    let table = picture.numbers(Tag::LINEARIZATION)?;
    linearize(&mut samples, &table);
    let white = white(picture, layout)?;
    let mut whole = Photograph {
        width,
        height,
        layout,
        samples,
        black: black(picture, layout)?,
        // DNG: the default is 2^bits − 1.
        white: white.or_else(|| is_dng.then(|| [f64::from((1_u32 << bits) - 1); 4])),
        about: About::of(bytes, picture, &directories),
    };
    let active = picture.whole(Tag::ACTIVE_AREA)?;
    if let Some(measured) = masked::black(&whole, &picture.whole(Tag::MASKED_AREAS)?, &active)? {
        whole.black = Some(measured);
    }
    cropped(whole, &active)
}

/// All directories, including subdirectories.
fn directories(bytes: Bytes) -> Result<Vec<Directory>, UnreadablePhotograph> {
    let mut found: Vec<Directory> = Vec::new();
    let mut places = vec![bytes.first()?];
    while let Some(at) = places.pop() {
        if at == 0 || found.len() >= MOST_DIRECTORIES {
            continue;
        }
        // Directories after the first may be damaged, provided that they are not the photograph.
        match Directory::read(bytes, at) {
            Ok(directory) => {
                places.push(directory.next);
                places.extend(directory.whole(Tag::SUB_IFDS)?.into_iter().take(MOST_DIRECTORIES));
                found.push(directory);
            }
            Err(error) if found.is_empty() => return Err(error),
            Err(_) => {}
        }
    }
    Ok(found)
}

/// The mosaic, else the linear picture; in files that are no DNG, else the first picture that is no preview.
fn photograph_of<'d, 'a>(
    all: &'d [Directory<'a>],
    is_dng: bool,
) -> Result<&'d Directory<'a>, UnreadablePhotograph> {
    let whole = |d: &&Directory| is_whole(d);
    let directory = |kind: u64| {
        all.iter().filter(whole).find(|d| d.whole_of(Tag::PHOTOMETRIC).ok().flatten() == Some(kind))
    };
    if let Some(raw) = directory(CFA).or_else(|| directory(LINEAR_RAW)) {
        return Ok(raw);
    }
    if is_dng {
        let needed = format!("a DNG's photograph has {CFA} (mosaic) or {LINEAR_RAW} (linear)");
        return Err(UnreadablePhotograph::missing(Tag::PHOTOMETRIC.name, needed));
    }
    let first = all
        .iter()
        .find(whole)
        .ok_or_else(|| UnreadablePhotograph::missing(Tag::WIDTH.name, "no picture has it"))?;
    match first.whole_of(Tag::COMPRESSION)? {
        Some(6 | 7) => Err(UnreadablePhotograph::Jpeg),
        _ => Ok(first),
    }
}

/// Whether a directory's picture is no preview, mask or map of another one; a page of several (2) counts as a picture.
fn is_whole(directory: &Directory) -> bool {
    let kind = directory.whole_of(Tag::SUBFILE_TYPE).ok().flatten();
    directory.has(Tag::WIDTH) && matches!(kind, None | Some(0 | 2))
}

/// Number of pictures that could equally be the photograph: pages, and those that ImageJ writes one after the other
/// behind a single directory.
fn pictures(all: &[Directory], chosen: &Directory) -> usize {
    let stated = chosen.text(Tag::DESCRIPTION).filter(|text| text.starts_with("ImageJ="));
    let digits = |text: &str| text.chars().take_while(char::is_ascii_digit).collect::<String>();
    let stated = stated.and_then(|text| digits(text.split_once("images=")?.1).parse().ok());
    let kind = |d: &Directory| d.whole_of(Tag::PHOTOMETRIC).ok().flatten();
    let alike = |d: &&Directory| is_whole(d) && kind(d) == kind(chosen) && bits(d).is_ok();
    all.iter().filter(alike).count().max(stated.unwrap_or(1))
}

/// Operations on samples that change their relation to light, by their numbers in a list of opcodes (DNG 1.4). A gain map is
/// in the flats as well.
const NOT_LINEAR: [(u32, &str); 4] =
    [(7, "MapTable"), (8, "MapPolynomial"), (10, "DeltaPerRow"), (11, "DeltaPerColumn")];

/// Refuses tags that change what samples mean, and that are not applied.
fn check_meaning(picture: &Directory) -> Result<(), UnreadablePhotograph> {
    let orders = [Tag::ROW_INTERLEAVE, Tag::COLUMN_INTERLEAVE, Tag::SUB_TILE, Tag::FILL_ORDER];
    for tag in orders {
        let values = picture.whole(tag)?;
        if values.iter().any(|value| *value != 1) {
            let allowed = "samples in another order are not read; write them in rows with a DNG converter";
            return Err(UnreadablePhotograph::tag(tag.name, format_args!("{values:?}"), allowed));
        }
    }
    for tag in [Tag::OPCODES_1, Tag::OPCODES_2] {
        let ids = picture.raw(tag).map(opcodes).unwrap_or_default();
        if let Some((_, name)) = NOT_LINEAR.iter().find(|(id, _)| ids.contains(id)) {
            let allowed =
                "it changes samples and is not applied; convert with a DNG converter that applies it";
            return Err(UnreadablePhotograph::tag(tag.name, name, allowed));
        }
    }
    Ok(())
}

/// The numbers of a list's operations: each has a number, a version, flags, the size of its data, and these.
fn opcodes(list: &[u8]) -> Vec<u32> {
    let number = |at: usize| Some(u32::from_be_bytes(list.get(at..at + 4)?.try_into().ok()?));
    let mut at = 4;
    let mut ids = Vec::new();
    while let (Some(id), Some(size)) = (number(at), number(at + 12)) {
        ids.push(id);
        at = at.saturating_add(16).saturating_add(size as usize);
        if at > list.len() {
            break;
        }
    }
    ids
}

/// Bits per sample.
fn bits(picture: &Directory) -> Result<u32, UnreadablePhotograph> {
    let bits = picture.whole(Tag::BITS)?;
    let first = bits.first().copied().unwrap_or(1);
    if bits.iter().any(|b| *b != first) {
        return Err(UnreadablePhotograph::tag(
            Tag::BITS.name,
            format_args!("{bits:?}"),
            "they must be the same for all samples",
        ));
    }
    if matches!(picture.whole_of(Tag::SAMPLE_FORMAT)?, Some(format) if format != 1) {
        return Err(UnreadablePhotograph::tag(
            Tag::SAMPLE_FORMAT.name,
            "floating point or signed",
            "write whole numbers of 16 bits",
        ));
    }
    match first {
        0..=8 => Err(UnreadablePhotograph::EightBit { bits: first as u32 }),
        9..=16 => Ok(first as u32),
        other => Err(UnreadablePhotograph::tag(Tag::BITS.name, other, "allowed are 9 to 16")),
    }
}

fn layout(picture: &Directory) -> Result<SampleLayout, UnreadablePhotograph> {
    let samples = picture.whole_of(Tag::SAMPLES)?.unwrap_or(1);
    let kind = picture.needed(Tag::PHOTOMETRIC)?;
    match (kind, samples) {
        (CFA, 1) => pattern(picture).map(|pattern| SampleLayout::Mosaic(Some(pattern))),
        // Grey may be a mosaic whose colours are not in the file, or that of a monochrome camera.
        (1 | LINEAR_RAW, 1) => Ok(SampleLayout::Mosaic(None)),
        (2 | LINEAR_RAW, 3) => match picture.whole_of(Tag::PLANAR)? {
            None | Some(1) => Ok(SampleLayout::Rgb),
            Some(other) => {
                Err(UnreadablePhotograph::tag(Tag::PLANAR.name, other, "allowed is 1, colours side by side"))
            }
        },
        (CFA | 1 | 2 | LINEAR_RAW, other) => {
            Err(UnreadablePhotograph::tag(Tag::SAMPLES.name, other, "allowed are 1 of a mosaic and 3 of RGB"))
        }
        (6, _) => Err(UnreadablePhotograph::Jpeg),
        (other, _) => {
            let allowed =
                format!("allowed are 1 (grey: a mosaic), 2 (RGB), {CFA} (mosaic), {LINEAR_RAW} (linear)");
            Err(UnreadablePhotograph::tag(Tag::PHOTOMETRIC.name, other, allowed))
        }
    }
}

/// The colours of a 2 × 2 mosaic.
fn pattern(picture: &Directory) -> Result<[Colour; 4], UnreadablePhotograph> {
    let size = picture.whole(Tag::CFA_DIM)?;
    if size != [2, 2] {
        let given = format!("{size:?}");
        return Err(UnreadablePhotograph::tag(
            Tag::CFA_DIM.name,
            given,
            "allowed are mosaics of 2 × 2 pixels",
        ));
    }
    if !matches!(picture.whole_of(Tag::CFA_LAYOUT)?, None | Some(1)) {
        return Err(UnreadablePhotograph::tag(Tag::CFA_LAYOUT.name, "no rectangle", "allowed is 1"));
    }
    let planes = picture.whole(Tag::CFA_PLANE_COLOR)?;
    if !planes.is_empty() && planes != [0, 1, 2] {
        let given = format!("{planes:?}");
        return Err(UnreadablePhotograph::tag(
            Tag::CFA_PLANE_COLOR.name,
            given,
            "allowed are red, green and blue: [0, 1, 2]",
        ));
    }
    let codes = picture.whole(Tag::CFA_PATTERN)?;
    let colours: Vec<Colour> = codes
        .iter()
        .filter_map(|code| match code {
            0 => Some(Colour::Red),
            1 => Some(Colour::Green),
            2 => Some(Colour::Blue),
            _ => None,
        })
        .collect();
    let refused = || {
        UnreadablePhotograph::tag(
            Tag::CFA_PATTERN.name,
            format_args!("{codes:?}"),
            "must be four of 0, 1 and 2",
        )
    };
    colours.try_into().map_err(|_| refused())
}

fn not_linear(picture: &Directory) -> Option<String> {
    if let Some(curve) = picture.raw(Tag::ICC).and_then(tone_curve) {
        return Some(curve);
    }
    let curve = picture.numbers(Tag::TRANSFER_FUNCTION).ok().filter(|curve| curve.len() > 2)?;
    let (last, rise) = ((curve.len().min(65_536) - 1) as f64, 65_535.0);
    // Three curves may be stored one after the other.
    let last = if curve.len().is_multiple_of(3) { (curve.len() / 3 - 1) as f64 } else { last };
    let straight = (0..=last as usize).all(|i| (curve[i] / rise - i as f64 / last).abs() < 1e-3);
    (!straight).then(|| "its TransferFunction".to_owned())
}

/// Black level by row and column modulo 2, or by colour. `None` where it varies within the picture.
fn black(picture: &Directory, layout: SampleLayout) -> Result<Option<[f64; 4]>, UnreadablePhotograph> {
    let levels = picture.numbers(Tag::BLACK)?;
    let size = picture.whole(Tag::BLACK_DIM)?;
    for delta in [Tag::BLACK_DELTA_H, Tag::BLACK_DELTA_V] {
        if picture.numbers(delta)?.iter().any(|d| d.abs() > 0.01) {
            return Ok(None);
        }
    }
    if levels.iter().any(|level| !(0.0..=65_535.0).contains(level)) {
        return Err(UnreadablePhotograph::tag(
            Tag::BLACK.name,
            format_args!("{levels:?}"),
            "allowed are 0 to 65535",
        ));
    }
    Ok(match (layout, levels.as_slice(), size.as_slice()) {
        (_, [all, others @ ..], _) if others.iter().all(|level| level == all) => Some([*all; 4]),
        (SampleLayout::Rgb, [r, g, b], _) => Some([*r, *g, *b, *g]),
        (SampleLayout::Mosaic(_), [a, b, c, d], [2, 2] | []) => Some([*a, *b, *c, *d]),
        (SampleLayout::Mosaic(_), [a, b], [1, 2]) => Some([*a, *b, *a, *b]),
        (SampleLayout::Mosaic(_), [a, b], [2, 1]) => Some([*a, *a, *b, *b]),
        _ => None,
    })
}

/// Level at which the sensor saturates, by row and column modulo 2, or by colour; the lowest if the tag has another
/// number of values.
fn white(picture: &Directory, layout: SampleLayout) -> Result<Option<[f64; 4]>, UnreadablePhotograph> {
    let levels: Vec<f64> = picture.numbers(Tag::WHITE)?.into_iter().filter(|level| *level > 0.0).collect();
    Ok(match (layout, levels.as_slice()) {
        (_, []) => None,
        (SampleLayout::Rgb, [r, g, b]) => Some([*r, *g, *b, *g]),
        (SampleLayout::Mosaic(_), [a, b, c, d]) => Some([*a, *b, *c, *d]),
        (_, levels) => Some([levels.iter().copied().fold(f64::INFINITY, f64::min); 4]),
    })
}

/// Expands companded values by the linearisation table.
fn linearize(samples: &mut [u16], table: &[f64]) {
    let Some(last) = table.len().checked_sub(1) else { return };
    for sample in samples {
        *sample = table[usize::from(*sample).min(last)].clamp(0.0, 65_535.0) as u16;
    }
}

/// Cuts off the masked margins: pattern and black level count from the active area's corner.
fn cropped(whole: Photograph, area: &[u64]) -> Result<Photograph, UnreadablePhotograph> {
    let Ok(area) = <[u64; 4]>::try_from(area) else { return Ok(whole) };
    let Some([top, left, bottom, right]) = within(area, &whole).filter(|[t, l, b, r]| t < b && l < r) else {
        let allowed = format!("it must lie within {} × {} pixels", whole.width, whole.height);
        return Err(UnreadablePhotograph::tag(Tag::ACTIVE_AREA.name, format_args!("{area:?}"), allowed));
    };
    if (top, left, bottom, right) == (0, 0, whole.height, whole.width) {
        return Ok(whole);
    }
    let n = whole.layout.samples_per_pixel();
    let rows = whole.samples.chunks_exact(whole.width * n).skip(top).take(bottom - top);
    let samples = rows.flat_map(|row| row[left * n..right * n].iter().copied()).collect();
    Ok(Photograph { width: right - left, height: bottom - top, samples, ..whole })
}
