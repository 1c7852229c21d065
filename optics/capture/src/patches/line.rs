//! Fits the line through the patches, and checks linearity, drift and gamma.

use super::exposures::{self, ExposedWhite};
use super::{Neutral, PatchShot, RawReading};
use crate::calibration::{LampDrift, PatchReading};
use crate::estimate::Estimate;
use crate::frame::{Area, Colour};
use crate::least_squares::{FittedParameters, NormalEquations};
use crate::refusal::{Refusal, Warning};

/// Relative deviation from the line above which a session is refused.
const NOT_LINEAR: f64 = 0.01;

/// Fewest patches that show linearity.
const LEAST: usize = 3;

/// Share of the frame's mean light that lens and camera scatter, where no patches show it.
const GLARE: Estimate = Estimate { value: 0.01, std_error: 0.01 };

/// Relative change of the light between shots above which a session is refused.
const DRIFT: f64 = 0.02;

/// Change above which a warning is given, and standard error of light that was measured once.
const NOTED_DRIFT: f64 = 0.005;
const UNKNOWN_DRIFT: f64 = 0.0025;

/// Powers of ρ beyond which a picture counts as gamma-coded.
const LINEAR_POWERS: std::ops::Range<f64> = 0.85..1.15;

#[derive(Debug, Default)]
pub(super) struct FittedLine {
    pub patches: Vec<PatchReading>,
    pub gain: Vec<Estimate>,
    pub glare: Vec<Estimate>,
    pub linearity: Vec<f64>,
    pub drift: Vec<f64>,
    pub light: LampDrift,
    pub warnings: Vec<Warning>,
}

pub(super) fn fit(
    neutral: &Neutral,
    shots: &[PatchShot],
    exposures: &[ExposedWhite],
    columns: &[Colour],
) -> Result<FittedLine, Refusal> {
    check_gamma(neutral, &shots[0])?;
    let mut fitted = FittedLine::default();
    let brightness = relative(shots, columns.len());
    fitted.drift = drift(shots, &brightness, columns)?;
    fitted.warnings.extend(drifted(columns, &fitted.drift));
    fitted.light = light(shots, &brightness, &mut fitted.warnings);
    let places = shots.first().map_or(&[][..], |shot| &shot.areas);
    let reading = |(rho, area): (&Vec<f64>, &Area)| PatchReading {
        rho: rho.clone(),
        area: *area,
        ..PatchReading::default()
    };
    let mut readings: Vec<PatchReading> = neutral.rho.iter().zip(places).map(reading).collect();
    for colour in columns {
        let means = mean_readings(shots, &brightness, colour.index());
        channel(neutral, &means, *colour, &mut fitted, &mut readings)?;
    }
    fitted.patches = readings;
    if !exposures.is_empty() {
        let found = exposures::linearity(exposures, columns)?;
        // Patches show as much of it as there is at their levels.
        let larger = |(found, by_patches): (&f64, &f64)| found.max(*by_patches);
        let by_both = found.iter().zip(&fitted.linearity).map(larger).collect();
        fitted.linearity = if neutral.rho.len() < LEAST { found } else { by_both };
    } else if neutral.rho.len() < LEAST {
        let patches = if neutral.rho.len() == 1 { "one patch" } else { "two patches" };
        fitted.warnings.push(Warning::LinearityUnknown { patches });
    }
    if neutral.rho.len() == 1 {
        fitted.warnings.push(Warning::GlareUnknown { percent: 100.0 * GLARE.value });
    }
    Ok(fitted)
}

/// Mean of all shots, each scaled to the mean brightness.
fn mean_readings(shots: &[PatchShot], brightness: &[Vec<f64>], c: usize) -> Vec<RawReading> {
    let n = shots.len() as f64;
    (0..shots[0].readings.len())
        .map(|i| {
            let sum = |f: fn(&RawReading) -> f64| -> f64 {
                shots.iter().zip(brightness).map(|(s, b)| f(&s.readings[i][c]) / b[c]).sum()
            };
            RawReading {
                light: sum(|r| r.light) / n,
                std_error: sum(|r| r.std_error) / n / n.sqrt(),
                veil: sum(|r| r.veil) / n,
            }
        })
        .collect()
}

fn channel(
    neutral: &Neutral,
    readings: &[RawReading],
    colour: Colour,
    fitted: &mut FittedLine,
    patches: &mut [PatchReading],
) -> Result<(), Refusal> {
    let c = colour.index();
    let white = neutral.white();
    let (rho, of_white) = (neutral.rho[white][c], readings[white]);
    let (k, glare) = if let [only] = readings {
        ((only.light - GLARE.value * only.veil) / rho, GLARE)
    } else {
        let line = regress(neutral, readings, c, false)
            .ok_or(Refusal::Missing { what: "patches of different ρ" })?;
        (line.x[0], Estimate::new(line.x[1], line.std_error(1)))
    };
    for (i, (patch, reading)) in patches.iter_mut().zip(readings).enumerate() {
        let rho = neutral.rho[i][c];
        let expected = k * rho + glare.value * reading.veil;
        let deviation = reading.light / expected - 1.0;
        patch.deviation.push(deviation);
        let own = libm::hypot(neutral.std_error * rho * k, reading.std_error) / expected;
        if deviation.is_nan() || deviation.abs() > NOT_LINEAR.max(3.0 * own) {
            let deviation = 100.0 * deviation;
            return Err(Refusal::NotLinear { colour, patch: i + 1, rho, deviation });
        }
    }
    let gain = (of_white.light - glare.value * of_white.veil) / rho;
    let gain_error = libm::hypot(of_white.std_error, glare.std_error * of_white.veil) / rho;
    fitted.gain.push(Estimate::new(gain, gain_error));
    fitted.glare.push(glare);
    for (patch, reading) in patches.iter_mut().zip(readings) {
        let value = (reading.light - glare.value * reading.veil) / gain;
        patch.value.push(Estimate::new(value, reading.std_error / gain));
    }
    // L = kρ + γM + qρ²: half-way, it deviates from the line through black and white by qρ/2.
    let curved =
        || regress(neutral, readings, c, true).map(|curve| (0.5 * rho * curve.x[2] / curve.x[0]).abs());
    let linearity = if readings.len() < LEAST { NOT_LINEAR } else { curved().unwrap_or(0.0).min(NOT_LINEAR) };
    fitted.linearity.push(linearity);
    Ok(())
}

/// Regression weighted by the errors of the certificate and the noise.
fn regress(neutral: &Neutral, readings: &[RawReading], c: usize, curved: bool) -> Option<FittedParameters> {
    let scale = readings[neutral.white()].light / neutral.rho[neutral.white()][c];
    let mut normal = NormalEquations::new(if curved { 3 } else { 2 });
    for (rho, reading) in neutral.rho.iter().map(|r| r[c]).zip(readings) {
        let sigma =
            libm::hypot(neutral.std_error.max(1e-4) * rho * scale, reading.std_error).max(1e-6 * scale);
        let row = [rho, reading.veil, rho * rho];
        normal.add(&row[..if curved { 3 } else { 2 }], reading.light, sigma.powi(-2));
    }
    normal.solve()
}

/// Brightness of each shot relative to the mean of all, weighted by light.
fn relative(shots: &[PatchShot], columns: usize) -> Vec<Vec<f64>> {
    let light = |shot: &PatchShot, c: usize| shot.readings.iter().map(|r| r[c].light).sum::<f64>();
    let mean = |c: usize| shots.iter().map(|shot| light(shot, c)).sum::<f64>() / shots.len() as f64;
    let means: Vec<f64> = (0..columns).map(mean).collect();
    let to_means = |shot| means.iter().enumerate().map(|(c, mean)| light(shot, c) / mean).collect();
    shots.iter().map(to_means).collect()
}

/// Largest relative change of the light between shots, in each column.
fn drift(shots: &[PatchShot], brightness: &[Vec<f64>], columns: &[Colour]) -> Result<Vec<f64>, Refusal> {
    let colour_drift = |colour: &Colour| {
        let c = colour.index();
        let order = |a: &usize, b: &usize| brightness[*a][c].total_cmp(&brightness[*b][c]);
        let least = (0..shots.len()).min_by(order).unwrap_or(0);
        let most = (0..shots.len()).max_by(order).unwrap_or(0);
        let (first, last) = (least.min(most), least.max(most));
        let drift = brightness[last][c] / brightness[first][c] - 1.0;
        if drift.abs() > DRIFT {
            let (first, last) = (shots[first].label.clone(), shots[last].label.clone());
            return Err(Refusal::LightDrifted { colour: *colour, percent: 100.0 * drift, first, last });
        }
        Ok(drift)
    };
    columns.iter().map(colour_drift).collect()
}

/// The warning about a drift that makes the larger part of the gain's error.
fn drifted(columns: &[Colour], drift: &[f64]) -> Option<Warning> {
    let most = columns.iter().zip(drift).max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
    let (colour, drift) = most.filter(|(_, drift)| drift.abs() > NOTED_DRIFT)?;
    Some(Warning::Drifted { colour: *colour, percent: 100.0 * drift })
}

fn light(shots: &[PatchShot], brightness: &[Vec<f64>], warnings: &mut Vec<Warning>) -> LampDrift {
    let (n, columns) = (shots.len() as f64, brightness[0].len());
    if shots.len() < 2 {
        warnings.push(Warning::NoDrift);
        return LampDrift { at: Vec::new(), std_error: vec![UNKNOWN_DRIFT; columns], shots: 1 };
    }
    let scatter = |c: usize| brightness.iter().map(|b| (b[c] - 1.0).powi(2)).sum::<f64>() / (n - 1.0);
    let std_error = (0..columns).map(|c| scatter(c).sqrt()).collect();
    let times: Option<Vec<f64>> = shots.iter().map(|s| s.seconds).collect();
    let Some(times) = times else {
        warnings.push(Warning::NoTimes);
        return LampDrift { at: Vec::new(), std_error, shots: shots.len() };
    };
    let mut at: Vec<_> = times.into_iter().zip(brightness.iter().cloned()).collect();
    at.sort_by(|a, b| a.0.total_cmp(&b.0));
    at.dedup_by(|later, earlier| later.0 <= earlier.0);
    LampDrift { at, std_error, shots: shots.len() }
}

/// Refuses brightness that follows a power of ρ other than the first. Patches in the wrong order follow no power.
fn check_gamma(neutral: &Neutral, shot: &PatchShot) -> Result<(), Refusal> {
    // Stray light is a large part of black patches.
    let sound = neutral.greens().into_iter().zip(shot.greens()).filter(|(rho, _)| *rho > BLACK);
    let points: Vec<[f64; 2]> =
        sound.map(|(rho, light)| [libm::log(rho), libm::log(light.max(1e-3))]).collect();
    let mut normal = NormalEquations::new(2);
    for [rho, light] in &points {
        normal.add(&[1.0, *rho], *light, 1.0);
    }
    let Some(line) = normal.solve() else { return Ok(()) };
    let exponent = line.x[1];
    let residual = |p: &[f64; 2]| (p[1] - line.x[0] - exponent * p[0]).powi(2);
    let scatter = (points.iter().map(residual).sum::<f64>() / points.len() as f64).sqrt();
    if exponent > 0.2 && !LINEAR_POWERS.contains(&exponent) && scatter < A_POWER {
        return Err(Refusal::GammaCoded { label: shot.label.clone(), exponent });
    }
    Ok(())
}

/// Reflectance of a patch that shows no power, since stray light changes it.
const BLACK: f64 = 0.02;

/// Scatter of ln L within which the patches follow a power.
const A_POWER: f64 = 0.15;
