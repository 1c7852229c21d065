//! Draws measured media over wavelength: what they scatter and absorb, and g, with 95 % intervals as bands.

use optics_model::fit::{ChannelFit, Interval, MaterialFit, Refined};
use optics_model::measurement::wavelength_nm;

use crate::drawing::axis::{Axis, extent};
use crate::drawing::canvas::{Canvas, PlotArea, Stroke, at};
use crate::drawing::frame::{AxesFrame, Labels, TICKS_BELOW, tick_width};
use crate::drawing::head::MARGIN;
use crate::drawing::legend::{Key, LegendRow};
use crate::drawing::picture::Picture;
use crate::drawing::rgb::Rgb;
use crate::drawing::text::{Anchor, LABEL, Text};

const WIDTH: f64 = 620.0;
const HEIGHT: f64 = 150.0;
const GAP: f64 = 14.0;
/// Fewest wavelengths of a curve.
const LEAST: usize = 3;
/// Smallest share of the largest σ_a that is drawn.
const SMALLEST: f64 = 1e-4;
/// Lines of materials, also distinguished by their dashes; further materials repeat these.
const LINES: [Stroke; 6] = [
    Stroke::solid(Rgb::BLUE, 1.6),
    Stroke::dashed(Rgb::VERMILLION, 1.6, &[7, 3]),
    Stroke::dashed(Rgb::GREEN, 1.6, &[2, 2]),
    Stroke::dashed(Rgb::PURPLE, 1.6, &[8, 3, 2, 3]),
    Stroke::dashed(Rgb::ORANGE, 1.6, &[12, 4]),
    Stroke::dashed(Rgb::INK, 1.6, &[4, 2]),
];

/// One quantity of a medium: its name, its value, and its interval.
struct SpectralQuantity {
    label: &'static str,
    logarithmic: bool,
    of: fn(&Refined) -> (f64, Interval),
}

const QUANTITIES: [SpectralQuantity; 3] = [
    SpectralQuantity {
        label: "σ_s(1−g) [1/mm]",
        logarithmic: false,
        of: |r| (r.best.medium.reduced_scattering_per_mm(), r.reduced_scattering_per_mm),
    },
    SpectralQuantity {
        label: "σ_a [1/mm]",
        logarithmic: true,
        of: |r| (r.best.medium.absorption_per_mm(), r.absorption_per_mm),
    },
    SpectralQuantity { label: "g", logarithmic: false, of: |r| (r.best.medium.g(), r.g) },
];

/// The channels of a material by rising wavelength.
struct MaterialSpectrum<'a> {
    material: &'a str,
    channels: Vec<(f64, &'a Refined)>,
}

/// None unless a material has three refined channels, and all are wavelengths.
pub fn spectra_figure(fits: &[MaterialFit]) -> Option<Picture> {
    let spectra: Vec<MaterialSpectrum> = fits.iter().filter_map(spectrum).collect();
    let keys: Vec<Key> =
        spectra.iter().enumerate().map(|(i, s)| Key::line(LINES[i % LINES.len()], s.material)).collect();
    let nm = extent(spectra.iter().flat_map(|s| s.channels.iter().map(|(nm, _)| *nm)))?;
    let legend = LegendRow::new(&keys, WIDTH - 2.0 * MARGIN);
    let x = Axis::exact(Some(nm));
    let axes = QUANTITIES.map(|quantity| axis(&quantity, &spectra));
    let top = |i: usize| MARGIN + legend.height() + 6.0 + i as f64 * (HEIGHT + GAP);
    let frames: Vec<AxesFrame> = axes
        .into_iter()
        .enumerate()
        .map(|(i, y)| {
            let area = PlotArea { left: 0.0, top: top(i), width: WIDTH, height: HEIGHT };
            AxesFrame { area, x, y }
        })
        .collect();
    let left = frames.iter().map(|frame| tick_width(&frame.y_ticks())).fold(0.0, f64::max);
    let left = MARGIN + 1.6 * LABEL + left;
    let bottom = top(QUANTITIES.len() - 1) + HEIGHT;
    let mut canvas = Canvas::new(WIDTH, bottom + TICKS_BELOW + 1.5 * LABEL + MARGIN);
    legend.draw(&mut canvas, left, MARGIN);
    for (i, (mut frame, quantity)) in frames.into_iter().zip(&QUANTITIES).enumerate() {
        frame.area.left = left;
        frame.area.width = WIDTH - MARGIN - left;
        draw_panel(&frame, &mut canvas, quantity, &spectra);
        frame.axes(&mut canvas, Labels { x: i + 1 == QUANTITIES.len(), y: true });
        let label = Text::new(quantity.label, LABEL).anchor(Anchor::Middle);
        canvas.text_upwards(at(MARGIN + LABEL, frame.area.center().y), &label);
    }
    let middle = left + 0.5 * (WIDTH - MARGIN - left);
    let label = Text::new("wavelength [nm]; bands: 95 % intervals", LABEL).anchor(Anchor::Middle);
    canvas.text(at(middle, bottom + TICKS_BELOW + 1.2 * LABEL), &label);
    Some(canvas.finish())
}

fn spectrum(fit: &MaterialFit) -> Option<MaterialSpectrum<'_>> {
    let channel = |c| {
        let ChannelFit { channel, refined, .. }: &ChannelFit = c;
        Some((wavelength_nm(channel)?, refined.as_ref()?))
    };
    let mut channels = fit.channels.iter().map(channel).collect::<Option<Vec<_>>>()?;
    channels.sort_by(|a, b| a.0.total_cmp(&b.0));
    (channels.len() >= LEAST).then_some(MaterialSpectrum { material: &fit.material, channels })
}

fn axis(quantity: &SpectralQuantity, spectra: &[MaterialSpectrum]) -> Axis {
    let all = || spectra.iter().flat_map(|s| s.channels.iter().map(|(_, r)| (quantity.of)(r)));
    let ends = all().flat_map(|(value, i)| [value, i.low, i.high]).filter(|v| v.is_finite());
    if !quantity.logarithmic {
        return Axis::around(extent(ends), 0.1);
    }
    let high = ends.fold(f64::MIN_POSITIVE, f64::max);
    let low = all().map(|(value, _)| value).filter(|v| *v > SMALLEST * high).fold(high, f64::min);
    Axis::logarithmic(0.8 * low, 1.1 * high)
}

fn draw_panel(
    frame: &AxesFrame,
    canvas: &mut Canvas,
    quantity: &SpectralQuantity,
    spectra: &[MaterialSpectrum],
) {
    frame.rules(canvas);
    let [bottom, top] = [0.0, 1.0].map(|end| frame.y.value(end));
    for (i, spectrum) in spectra.iter().enumerate() {
        let interval = |(nm, r): &(f64, &Refined)| (*nm, (quantity.of)(r).1);
        let intervals: Vec<(f64, Interval)> = spectrum.channels.iter().map(interval).collect();
        let inside = |v: f64, open: f64| if v.is_finite() { v.clamp(bottom, top) } else { open };
        let above = intervals.iter().map(|(nm, i)| frame.place(*nm, inside(i.high, top)));
        let below = intervals.iter().rev().map(|(nm, i)| frame.place(*nm, inside(i.low, bottom)));
        let tint = LINES[i % LINES.len()].colour.tint();
        canvas.polygon(&above.chain(below).collect::<Vec<_>>(), Some(tint), Stroke::solid(tint, 0.0));
    }
    for (i, spectrum) in spectra.iter().enumerate() {
        let nm: Vec<f64> = spectrum.channels.iter().map(|(nm, _)| *nm).collect();
        let value =
            |(_, r): &(f64, &Refined)| Some((quantity.of)(r).0).filter(|v| (bottom..=top).contains(v));
        let values: Vec<f64> = spectrum.channels.iter().map(|c| value(c).unwrap_or(f64::NAN)).collect();
        frame.curve(canvas, &nm, &values, LINES[i % LINES.len()]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::assert_shows;
    use crate::testing;

    fn material(name: &str, channels: &[&str]) -> MaterialFit {
        let channels = channels.iter().zip(1..).map(|(c, i)| testing::channel(c, f64::from(i), 1.0));
        MaterialFit { material: name.to_owned(), channels: channels.collect() }
    }

    /// Wavelengths are drawn, in any order and with units; colours are not.
    #[test]
    fn spectra_need_wavelengths() {
        let white = material("white", &["550", "450 nm", "650"]);
        let picture = spectra_figure(&[white, material("red", &["R", "G", "B"])]).unwrap();
        let texts = assert_shows(&picture, &["white", "σa [1/mm]", "wavelength [nm]"]);
        assert!(!picture.svg().contains("NaN") && !texts.iter().any(|t| t == "red"));
        for few in [vec!["450", "550"], vec!["R", "G", "B"], vec![]] {
            assert!(spectra_figure(&[material("m", &few)]).is_none(), "{few:?}");
        }
    }
}
