//! Draws Fig. 3: the effect of a small change of each parameter on a profile.

use anyhow::{Context, Result};
use optics_fit::shown_derivative;
use optics_model::fit::{Curve, FitSettings};
use optics_model::job::JobSpec;
use optics_model::{Medium, TransportPoint};

use farm_figures::numbers::{albedo, significant};
use farm_figures::{ChangesFigure, ChangesPanel, LabelledCurve, Picture, changes_figure};

use crate::traced::traced;

/// Traces the medium and its neighbours, each of which has σ_t, 1 − α or 1 − g smaller or larger by the relative
/// `change`, and draws the first channel. Runs on the current rayon pool.
pub(super) fn picture(job: &JobSpec, medium: &Medium, change: f64) -> Result<Picture> {
    let (s, a, g) = (medium.sigma_t_per_mm(), medium.albedo(), medium.g());
    let both = [1.0 - change, 1.0 + change];
    let changed = |share: f64, v: f64| (1.0 - share * (1.0 - v)).max(0.0);
    let reference = profile(job, medium)?;
    let mut panels = Vec::new();
    for (parameter, value, media) in [
        ("σ_t", format!("{} /mm", significant(s, 3)), both.map(|c| Medium::new(s * c, a, g))),
        ("α", albedo(a), both.map(|c| Medium::new(s, changed(c, a), g))),
        ("g", significant(g, 3), both.map(|c| Medium::new(s, a, 1.0 - c * (1.0 - g)))),
    ] {
        let label = |m: &Medium| match parameter {
            "σ_t" => format!("σ_t = {} /mm", significant(m.sigma_t_per_mm(), 3)),
            "α" => format!("α = {}", albedo(m.albedo())),
            _ => format!("g = {}", significant(m.g(), 3)),
        };
        let curve = |m: Result<Medium, _>| -> Result<LabelledCurve> {
            let m = m.context("a changed medium")?;
            Ok(LabelledCurve { label: label(&m), curve: profile(job, &m)? })
        };
        panels.push(ChangesPanel {
            parameter: parameter.to_owned(),
            thickness_mm: job.point().thickness_mm(),
            reference: LabelledCurve { label: format!("{parameter} = {value}"), curve: reference.clone() },
            changed: media.into_iter().map(curve).collect::<Result<_>>()?,
        });
    }
    let title = format!(
        "Changes of {} % about σ_t {} /mm, α {}, g {} (channel {})",
        significant(100.0 * change, 2),
        significant(s, 3),
        albedo(a),
        significant(g, 3),
        job.scene().channels()[0].name()
    );
    let sensor = job.scene().sensor();
    let x_mm = (0..sensor.pixels()).map(|i| sensor.centre_mm(i)).collect();
    changes_figure(&ChangesFigure { title, x_mm, panels })
}

fn profile(job: &JobSpec, medium: &Medium) -> Result<Curve> {
    let point = TransportPoint::new(
        medium.sigma_t_per_mm(),
        medium.g(),
        job.point().thickness_mm(),
        job.point().sample_ior(),
    )?;
    let scene = job.scene().clone();
    let job = JobSpec::new(scene, point, vec![medium.albedo()], job.walks(), job.seed(), false)?;
    let records = traced(&job)?;
    let record = records.first().context("the tracer gave no record")?;
    let values: Vec<f64> =
        record.profiles[0].radiance_factor.values().iter().copied().map(f64::from).collect();
    let settings = FitSettings::default();
    let scale = 10.0 / 360.0 / job.scene().sensor().pitch_mm();
    let slope = shown_derivative(&values, settings.wavelet, settings.level);
    Ok(Curve { gradient: slope.iter().map(|d| d.abs() * scale).collect(), values })
}
