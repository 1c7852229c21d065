//! Draws profiles of a medium, predicted or simulated, a panel for each channel, with their noise below.

use optics_model::Medium;
use optics_model::fit::{Curve, PredictedChannel, PredictedProfiles};

use crate::drawing::canvas::Stroke;
use crate::drawing::legend::Key;
use crate::drawing::number::number;
use crate::drawing::picture::Picture;
use crate::drawing::rgb::Rgb;
use crate::drawing::sheet::{Sheet, SheetCell};

const PROFILE: Stroke = Stroke::solid(Rgb::BLUE, 1.5);
const BAND: Stroke = Stroke::dashed(Rgb::ORANGE, 1.0, &[3, 2]);

/// Half-width of an interval of 95 %, in standard errors.
const WIDE: f64 = 1.96;

/// Profiles that a dictionary predicts, with the noise of its records.
pub fn profile_figure(profiles: &PredictedProfiles) -> anyhow::Result<Picture> {
    let kind = if profiles.recorded { "a record's medium" } else { "between records" };
    ProfileSheet {
        medium: &profiles.medium,
        thickness_mm: profiles.thickness_mm,
        kind,
        legend: ["predicted", "95 % of the records' noise"],
        x_mm: &profiles.pixels.x_mm(),
        channels: &profiles.channels,
    }
    .draw()
}

/// Profiles of random walks, with their noise.
pub fn simulated_figure(
    medium: &Medium,
    thickness_mm: f64,
    walks: u64,
    x_mm: &[f64],
    channels: &[PredictedChannel],
) -> anyhow::Result<Picture> {
    let kind = format!("{walks} walks");
    let legend = ["simulated", "95 % of the walks' noise"];
    ProfileSheet { medium, thickness_mm, kind: &kind, legend, x_mm, channels }.draw()
}

struct ProfileSheet<'a> {
    medium: &'a Medium,
    thickness_mm: f64,
    kind: &'a str,
    /// Names of the profile and of its interval.
    legend: [&'static str; 2],
    x_mm: &'a [f64],
    channels: &'a [PredictedChannel],
}

impl ProfileSheet<'_> {
    fn draw(&self) -> anyhow::Result<Picture> {
        let m = self.medium;
        let title = format!(
            "σ_t = {} / mm, α = {}, g = {} ({})",
            number(m.sigma_t_per_mm(), 4),
            number(m.albedo(), 6),
            number(m.g(), 3),
            self.kind
        );
        let [name, interval] = self.legend;
        let mut legend = vec![Key::line(PROFILE, name)];
        if self.channels.iter().any(|channel| channel.std_errors.is_some()) {
            legend.push(Key::line(BAND, interval));
        }
        let curves: Vec<_> = self.channels.iter().map(|c| (curve(c), band(c))).collect();
        let cells = self.channels.iter().zip(&curves).map(|(channel, (profile, band))| SheetCell {
            column: &channel.channel,
            thickness_mm: self.thickness_mm,
            keys: Vec::new(),
            x_mm: self.x_mm,
            curves: std::iter::once((PROFILE, profile))
                .chain(band.iter().flatten().map(|curve| (BAND, curve)))
                .collect(),
            residuals: None,
        });
        let lower = "95 %, ± [10⁻³]";
        Sheet { title: &title, legend, cells: cells.collect(), alike: true, lower }.draw()
    }
}

fn curve(channel: &PredictedChannel) -> Curve {
    Curve { values: channel.values.clone(), gradient: vec![f64::NAN; channel.values.len()] }
}

/// The ends of the intervals. They hardly differ from the profile at its scale, so the lower panel has the half-width, with
/// the upper end.
fn band(channel: &PredictedChannel) -> Option<[Curve; 2]> {
    let errors = channel.std_errors.as_ref()?;
    let end = |sign: f64| channel.values.iter().zip(errors).map(|(v, e)| v + sign * WIDE * e).collect();
    let half_width = errors.iter().map(|error| 1000.0 * WIDE * error).collect();
    Some([
        Curve { values: end(-1.0), gradient: vec![f64::NAN; errors.len()] },
        Curve { values: end(1.0), gradient: half_width },
    ])
}
