//! Decodes PNG with 16 bits per sample.

use std::io::Cursor;

use super::icc::tone_curve;
use super::unreadable::UnreadablePhotograph;
use super::{About, Photograph, SampleLayout, checked_samples, checked_size};

pub(super) fn decode(bytes: &[u8]) -> Result<Photograph, UnreadablePhotograph> {
    let damaged = |e: png::DecodingError| UnreadablePhotograph::Damaged(e.to_string());
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    decoder.set_transformations(png::Transformations::IDENTITY);
    let mut reader = decoder.read_info().map_err(damaged)?;
    let info = reader.info();
    let (width, height) = checked_size(u64::from(info.width), u64::from(info.height))?;
    if info.bit_depth != png::BitDepth::Sixteen {
        return Err(UnreadablePhotograph::EightBit { bits: info.bit_depth as u32 });
    }
    if let Some(seen) = not_linear(info) {
        return Err(UnreadablePhotograph::NotLinear { seen });
    }
    let layout = match info.color_type {
        png::ColorType::Rgb => SampleLayout::Rgb,
        png::ColorType::Grayscale => SampleLayout::Mosaic(None),
        other => {
            let allowed = "allowed are grey and RGB without alpha";
            return Err(UnreadablePhotograph::tag("colour type", format_args!("{other:?}"), allowed));
        }
    };
    let about = info.exif_metadata.as_deref().map_or_else(About::default, About::of_exif);
    checked_samples(bytes.len(), (width * height * layout.samples_per_pixel()) as u64)?;
    let length = 2 * width * height * layout.samples_per_pixel();
    let mut pixels = vec![0; length];
    reader.next_frame(&mut pixels).map_err(damaged)?;
    let samples = pixels.chunks_exact(2).map(|b| u16::from_be_bytes([b[0], b[1]])).collect();
    Ok(Photograph { width, height, layout, samples, black: None, white: None, about })
}

/// The tone curve that the file declares; without one, values are taken to be linear, which the grey patches verify.
fn not_linear(info: &png::Info) -> Option<String> {
    if info.srgb.is_some() {
        return Some("an sRGB chunk".to_owned());
    }
    if let Some(curve) = info.icc_profile.as_deref().and_then(tone_curve) {
        return Some(curve);
    }
    let gamma = info.gama_chunk?.into_value();
    ((gamma - 1.0).abs() > 0.01).then(|| format!("a gAMA chunk of {gamma}"))
}
