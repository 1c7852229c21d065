//! Simulates a camera: geometry, blur, noise and faults from the scene to sample values.

use optics_capture::{Colour, Exposure, Frame, Levels, Pattern, Photo};
use rayon::prelude::*;

use super::noise::Random;
use super::subject::{Image, Subject};

/// Properties of the camera and the lighting.
#[derive(Debug, Clone)]
pub struct Camera {
    pub width: usize,
    pub height: usize,
    pub px_per_mm: f64,
    /// Rotation, clockwise.
    pub turn_deg: f64,
    /// Relative change of scale across the frame's width and height.
    pub keystone: [f64; 2],
    /// Relative growth of distances at the frame's corners.
    pub radial: f64,
    /// Pixel of the board's origin, from the frame's middle.
    pub origin_px: [f64; 2],
    /// σ of the lens per channel.
    pub lens_mm: [f64; 3],
    /// Factor on the blur up and down, due to shake.
    pub shaken: f64,
    /// Loss of light at the corners.
    pub vignetting: f64,
    /// Relative change of the light across the frame.
    pub slope: [f64; 2],
    pub glare: f64,
    /// Sample value of a radiance factor of 1, per channel.
    pub full: [f64; 3],
    pub numbers_per_electron: f64,
    pub read: f64,
    pub fixed_pattern: f64,
    pub black: f64,
    pub clip: f64,
    /// L becomes L (1 + curve (L/full − ½)).
    pub curve: f64,
    /// Gamma of the sample values; 1 in a raw file.
    pub gamma: f64,
    pub has_black_level: bool,
    /// Three samples per pixel instead of a mosaic.
    pub rgb: bool,
    /// All pixels record green: a monochrome camera.
    pub monochrome: bool,
    /// Exposure in its files.
    pub exposure_s: f64,
}

impl Default for Camera {
    fn default() -> Self {
        Self {
            width: 1040,
            height: 600,
            px_per_mm: 34.0,
            turn_deg: 1.3,
            keystone: [0.004, -0.003],
            radial: 0.0,
            origin_px: [9.3, -6.2],
            lens_mm: [0.028, 0.025, 0.0275],
            shaken: 1.0,
            vignetting: 0.06,
            slope: [0.03, -0.02],
            glare: 0.004,
            full: [6000.0, 11000.0, 7500.0],
            numbers_per_electron: 0.5,
            read: 3.0,
            fixed_pattern: 0.0,
            black: 512.0,
            clip: 16383.0,
            curve: 0.0,
            gamma: 1.0,
            has_black_level: true,
            rgb: false,
            monochrome: false,
            exposure_s: 0.05,
        }
    }
}

/// One exposure.
#[derive(Debug, Clone)]
pub struct Shot {
    pub label: String,
    pub seed: u64,
    /// Brightness of the lamps.
    pub brightness: f64,
    pub seconds: Option<f64>,
    /// Without noise, and with rounding below 1/65,000.
    pub exact: bool,
    pub dust: Option<Dust>,
}

/// Specks, and scratches across the frame.
#[derive(Debug, Clone, Copy)]
pub struct Dust {
    pub specks: usize,
    pub scratches: usize,
}

impl Shot {
    pub fn new(label: &str, seed: u64) -> Self {
        Self { label: label.into(), seed, brightness: 1.0, seconds: None, exact: false, dust: None }
    }
}

const MOSAIC: [Colour; 4] = [Colour::Red, Colour::Green, Colour::Green, Colour::Blue];

impl Camera {
    /// The board's plane at a pixel.
    pub fn mm(&self, px: [f64; 2]) -> [f64; 2] {
        let (w, h) = (self.width as f64, self.height as f64);
        let (x, y) = (px[0] - 0.5 * w, px[1] - 0.5 * h);
        let grown = 1.0 + self.radial * (x * x + y * y) / (0.25 * (w * w + h * h));
        let (ox, oy) = (self.origin_px[0], self.origin_px[1]);
        let (x, y) = (x * grown - ox, y * grown - oy);
        let depth = 1.0 + self.keystone[0] * x / w + self.keystone[1] * y / h;
        let (sin, cos) = libm::sincos(self.turn_deg.to_radians());
        let scale = self.px_per_mm * depth;
        [(cos * x + sin * y) / scale, (-sin * x + cos * y) / scale]
    }

    fn light(&self, px: [f64; 2]) -> f64 {
        let (u, v) = (px[0] / self.width as f64 - 0.5, px[1] / self.height as f64 - 0.5);
        (1.0 + self.slope[0] * u + self.slope[1] * v) * (1.0 - self.vignetting * 2.0 * (u * u + v * v))
    }

    /// Samples of a row.
    fn stride(&self) -> usize {
        if self.rgb { 3 * self.width } else { self.width }
    }

    /// Column, row and channel of a sample.
    fn place(&self, i: usize) -> (usize, usize, usize) {
        let (along, y) = (i % self.stride(), i / self.stride());
        match () {
            () if self.rgb => (along / 3, y, along % 3),
            () if self.monochrome => (along, y, Colour::Green.index()),
            () => (along, y, MOSAIC[along % 2 + 2 * (y % 2)].index()),
        }
    }

    fn fixed(&self) -> Option<Vec<f32>> {
        let mut random = Random::new(77);
        (self.fixed_pattern > 0.0).then(|| {
            (0..self.stride() * self.height).map(|_| (self.fixed_pattern * random.normal()) as f32).collect()
        })
    }
}

/// Light on each pixel of the mosaic, in noise-free numbers above black, for lamps of brightness 1.
#[must_use]
pub fn expose(camera: &Camera, subject: &Subject) -> Vec<f64> {
    let channels: &[usize] = if camera.monochrome { &[Colour::Green.index()] } else { &[0, 1, 2] };
    let image = Image::new(subject, camera.lens_mm, camera.shaken, channels);
    let row = |y: usize| {
        let samples = y * camera.stride()..(y + 1) * camera.stride();
        let sample = |i: usize| {
            let (x, y, c) = camera.place(i);
            pixel(camera, &image, c, [x as f64, y as f64])
        };
        samples.map(sample).collect::<Vec<f64>>()
    };
    let rows: Vec<Vec<f64>> = (0..camera.height).into_par_iter().map(row).collect();
    let mut light = rows.concat();
    veil(camera, &mut light);
    light
}

/// The integral over one pixel by Gauss quadrature with three points each way, exact to the fifth order.
fn pixel(camera: &Camera, image: &Image, c: usize, corner: [f64; 2]) -> f64 {
    const NODES: [(f64, f64); 3] =
        [(0.112_701_665_379_258_3, 5.0 / 18.0), (0.5, 8.0 / 18.0), (0.887_298_334_620_741_7, 5.0 / 18.0)];
    if image.is_dark() {
        return 0.0;
    }
    if image.is_even() {
        let px = [corner[0] + 0.5, corner[1] + 0.5];
        return image.at(c, camera.mm(px), px) * camera.light(px) * camera.full[c];
    }
    let mut sum = 0.0;
    for (dy, wy) in NODES {
        for (dx, wx) in NODES {
            let px = [corner[0] + dx, corner[1] + dy];
            sum += wx * wy * image.at(c, camera.mm(px), px) * camera.light(px);
        }
    }
    sum * camera.full[c]
}

/// Adds veiling glare: a share of each channel's mean.
fn veil(camera: &Camera, light: &mut [f64]) {
    let channel = |i: usize| camera.place(i).2;
    let mut sums = [[0.0; 2]; 3];
    for (i, v) in light.iter().enumerate() {
        sums[channel(i)][0] += v;
        sums[channel(i)][1] += 1.0;
    }
    for (i, v) in light.iter_mut().enumerate() {
        let [sum, count] = sums[channel(i)];
        *v = *v * (1.0 - camera.glare) + camera.glare * sum / count.max(1.0);
    }
}

/// A shot of exposed light.
#[must_use]
pub fn develop(camera: &Camera, light: &[f64], shot: &Shot) -> Photo {
    let mut random = Random::new(shot.seed);
    let mut light = light.to_vec();
    if let Some(dust) = shot.dust {
        sprinkle(camera, &mut light, dust, &mut random);
    }
    let fixed = camera.fixed();
    // An exact shot uses the full range of sixteen bits.
    let fine = if shot.exact { 65_000.0 / camera.clip } else { 1.0 };
    let samples = light
        .iter()
        .enumerate()
        .map(|(i, light)| {
            let full = camera.full[1];
            let mut signal = light * shot.brightness;
            signal *= 1.0 + camera.curve * (signal / full - 0.5);
            if camera.gamma != 1.0 {
                signal = full * libm::pow(signal.max(0.0) / full, camera.gamma);
            }
            let variance = camera.read.powi(2) + camera.numbers_per_electron * signal.max(0.0);
            if !shot.exact {
                signal += variance.sqrt() * random.normal();
            }
            let pattern = fixed.as_ref().map_or(0.0, |f| f64::from(f[i]));
            let number = (camera.black + pattern + signal).min(camera.clip) * fine;
            number.round().clamp(0.0, 65_535.0) as u16
        })
        .collect();
    let pattern = match () {
        () if camera.rgb => Pattern::Rgb,
        () if camera.monochrome => Pattern::MONOCHROME,
        () => Pattern::Bayer(MOSAIC),
    };
    let frame = Frame::new(camera.width, camera.height, pattern, samples);
    let levels = Levels {
        black: camera.has_black_level.then_some([camera.black * fine; 4]),
        white: Some([camera.clip * fine; 4]),
    };
    let exposure = Some(Exposure { time_s: camera.exposure_s, f_number: Some(11.0), iso: Some(100.0) });
    Photo { label: shot.label.clone(), frame: frame.unwrap(), levels, seconds: shot.seconds, exposure }
}

/// Dust darkens specks of a few pixels, scratches brighten or darken thin lines.
fn sprinkle(camera: &Camera, light: &mut [f64], dust: Dust, random: &mut Random) {
    let (w, h) = (camera.width as f64, camera.height as f64);
    for _ in 0..dust.specks {
        let (x, y, r) = (random.between(0.0, w), random.between(0.0, h), random.between(1.0, 4.0));
        let factor = random.between(0.5, 0.95);
        disc(camera, light, [x, y], r, factor);
    }
    for _ in 0..dust.scratches {
        let (mut x, mut y) = (random.between(0.0, w), random.between(0.0, h));
        let turn = random.between(0.0, std::f64::consts::TAU);
        let factor = random.between(0.9, 1.15);
        for _ in 0..(0.4 * h) as usize {
            (x, y) = (x + libm::cos(turn), y + libm::sin(turn));
            disc(camera, light, [x, y], 0.6, factor);
        }
    }
}

fn disc(camera: &Camera, light: &mut [f64], at: [f64; 2], radius: f64, factor: f64) {
    let range = |v: f64, limit: usize| {
        (v - radius).max(0.0) as usize..((v + radius).max(0.0) as usize + 1).min(limit)
    };
    let planes = camera.stride() / camera.width;
    for y in range(at[1], camera.height) {
        for x in range(at[0], camera.width) {
            if libm::hypot(x as f64 + 0.5 - at[0], y as f64 + 0.5 - at[1]) < radius {
                let first = y * camera.stride() + planes * x;
                light[first..first + planes].iter_mut().for_each(|v| *v *= factor);
            }
        }
    }
}
