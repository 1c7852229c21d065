//! Renders small pictures of photographs in sRGB.

use base64::Engine as _;
use optics_capture::Frame;

/// Width of the pictures in the report, in pixels.
const WIDTH: usize = 360;

/// A downscaled photograph: mean raw numbers of the sensor per channel.
#[derive(Debug, Clone, Default)]
pub struct Thumbnail {
    pub width: usize,
    pub height: usize,
    /// Width and height of the photograph.
    pub full: [usize; 2],
    values: Vec<[f32; 3]>,
}

impl Thumbnail {
    pub fn of(frame: &Frame) -> Self {
        let scale = frame.width().div_ceil(WIDTH).max(2);
        let (width, height) = (frame.width() / scale, frame.height() / scale);
        let mut values = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                values.push(mean(frame, x * scale, y * scale, scale));
            }
        }
        Self { width, height, full: [frame.width(), frame.height()], values }
    }

    /// The least mean number of each channel.
    pub fn darkest(&self) -> [f64; 3] {
        std::array::from_fn(|c| self.values.iter().map(|v| f64::from(v[c])).fold(f64::INFINITY, f64::min))
    }

    /// An sRGB picture as a data URI: the black level is black, the brightest hundredth white.
    pub fn data_uri(&self, black: [f64; 3]) -> String {
        let above = |v: &[f32; 3], c: usize| (f64::from(v[c]) - black[c]).max(0.0);
        let mut levels: [Vec<f64>; 3] =
            std::array::from_fn(|c| self.values.iter().map(|v| above(v, c)).collect());
        let whites = levels.each_mut().map(|values| {
            values.sort_by(f64::total_cmp);
            values.get(values.len() * 99 / 100).copied().unwrap_or(1.0).max(30.0)
        });
        let bytes = self
            .values
            .iter()
            .flat_map(|v| std::array::from_fn::<u8, 3, _>(|c| srgb(above(v, c) / whites[c])));
        data_uri(self.width, self.height, &bytes.collect::<Vec<u8>>())
    }
}

fn mean(frame: &Frame, left: usize, top: usize, side: usize) -> [f32; 3] {
    let (mut sums, mut counts) = ([0_u64; 3], [0_u32; 3]);
    for site in frame.sites() {
        for (x, y) in site.pixels(left..left + side, top..top + side, 1) {
            sums[site.colour.index()] += u64::from(frame.at(site, x, y));
            counts[site.colour.index()] += 1;
        }
    }
    std::array::from_fn(|c| sums[c] as f32 / counts[c].max(1) as f32)
}

/// The sRGB byte of a linear value (IEC 61966-2-1).
pub fn srgb(linear: f64) -> u8 {
    let v = linear.clamp(0.0, 1.0);
    let coded = if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * libm::pow(v, 1.0 / 2.4) - 0.055 };
    (255.0 * coded).round() as u8
}

/// A PNG as a data URI, to be embedded in a page.
pub fn data_uri(width: usize, height: usize, rgb: &[u8]) -> String {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Balanced);
    // Writing to memory fails only for sizes that do not fit, such as an empty picture.
    let written = encoder.write_header().and_then(|mut writer| writer.write_image_data(rgb));
    if written.is_err() {
        return "data:,".to_owned();
    }
    format!("data:image/png;base64,{}", base64::engine::general_purpose::STANDARD.encode(&file))
}

#[cfg(test)]
mod tests {
    use optics_capture::{Colour, Pattern};

    use super::*;

    #[test]
    fn mosaic_is_averaged_colour_by_colour() {
        let pattern = [Colour::Red, Colour::Green, Colour::Green, Colour::Blue];
        let samples = (0..64 * 64).map(|i| [10, 20, 20, 30][2 * (i / 64 % 2) + i % 2]).collect();
        let frame = Frame::new(64, 64, Pattern::Bayer(pattern), samples).unwrap();
        let small = Thumbnail::of(&frame);
        assert_eq!((small.width, small.height), (32, 32));
        assert!(small.values.iter().all(|v| *v == [10.0, 20.0, 30.0]));
        assert!(small.data_uri([0.0; 3]).starts_with("data:image/png;base64,iVBORw0KGgo"));
    }

    /// Half the light has the sRGB value 188.
    #[test]
    fn half_the_light_has_srgb_188() {
        assert_eq!([0.0, 0.5, 1.0, 2.0].map(srgb), [0, 188, 255, 255]);
    }
}
