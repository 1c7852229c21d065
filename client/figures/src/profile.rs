//! Draws profiles that a dictionary predicts, a panel for each channel, with intervals due to the records' noise.

use optics_model::fit::{Curve, PredictedChannel, PredictedProfiles};

use crate::drawing::canvas::Stroke;
use crate::drawing::legend::Key;
use crate::drawing::number::number;
use crate::drawing::picture::Picture;
use crate::drawing::rgb::Rgb;
use crate::drawing::sheet::{Sheet, SheetCell};

const PROFILE: Stroke = Stroke::solid(Rgb::BLUE, 1.5);
const BAND: Stroke = Stroke::dashed(Rgb::ORANGE, 1.0, "3 2");

/// Half-width of an interval of 95 %, in standard errors.
const WIDE: f64 = 1.96;

/// Pixel pitch of the gradients: the paper's 10 mm / 360, as in the figures of fits.
const PAPERS_PITCH_MM: f64 = 10.0 / 360.0;

pub fn profile_figure(profiles: &PredictedProfiles) -> anyhow::Result<Picture> {
    let m = &profiles.medium;
    let kind = if profiles.recorded { "a record's medium" } else { "between records" };
    let title = format!(
        "σ_t = {} / mm, α = {}, g = {} ({kind})",
        number(m.sigma_t_per_mm(), 4),
        number(m.albedo(), 6),
        number(m.g(), 3)
    );
    let x_mm = profiles.pixels.x_mm();
    let bands: Vec<[Curve; 2]> = profiles.channels.iter().filter_map(band).collect();
    let mut legend = vec![Key::line(PROFILE, "predicted")];
    if !bands.is_empty() {
        legend.push(Key::line(BAND, "95 % of the records' noise"));
    }
    legend.push(Key::note("|∇| per pixel of 10 mm / 360"));
    let curves: Vec<Curve> = profiles.channels.iter().map(curve).collect();
    let cells = profiles.channels.iter().enumerate().map(|(i, channel)| SheetCell {
        column: &channel.channel,
        thickness_mm: profiles.thickness_mm,
        keys: Vec::new(),
        x_mm: &x_mm,
        curves: std::iter::once((PROFILE, &curves[i]))
            .chain(bands.get(i).into_iter().flatten().map(|curve| (BAND, curve)))
            .collect(),
        residuals: None,
    });
    Sheet { title: &title, legend, cells: cells.collect(), alike: true }.draw()
}

fn curve(channel: &PredictedChannel) -> Curve {
    Curve {
        values: channel.values.clone(),
        gradient: channel.gradient.iter().map(|d| d.abs() * PAPERS_PITCH_MM).collect(),
    }
}

/// The ends of the intervals, without gradients.
fn band(channel: &PredictedChannel) -> Option<[Curve; 2]> {
    let errors = channel.std_errors.as_ref()?;
    let end = |sign: f64| Curve {
        values: channel.values.iter().zip(errors).map(|(v, e)| v + sign * WIDE * e).collect(),
        gradient: vec![f64::NAN; errors.len()],
    };
    Some([end(-1.0), end(1.0)])
}
