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
const DRIFT: f64 = 0.005;

/// Powers of ρ beyond which a picture counts as gamma-coded.
const LINEAR_POWERS: std::ops::Range<f64> = 0.85..1.15;

#[derive(Debug, Default)]
pub(super) struct FittedLine {
    pub patches: Vec<PatchReading>,
    pub gain: [Estimate; 3],
    pub glare: [Estimate; 3],
    pub linearity: [f64; 3],
    pub drift: [f64; 3],
    pub light: LampDrift,
    pub warnings: Vec<Warning>,
}

pub(super) fn fit(
    neutral: &Neutral,
    shots: &[PatchShot],
    exposures: &[ExposedWhite],
) -> Result<FittedLine, Refusal> {
    check_gamma(neutral, &shots[0])?;
    let mut fitted = FittedLine::default();
    let brightness: Vec<[f64; 3]> = relative(shots);
    check_drift(shots, &brightness, &mut fitted)?;
    fitted.light = light(shots, &brightness, &mut fitted.warnings);
    let places = shots.first().map_or(&[][..], |shot| &shot.areas);
    let reading =
        |(rho, area): (&[f64; 3], &Area)| PatchReading { rho: *rho, area: *area, ..PatchReading::default() };
    let mut readings: Vec<PatchReading> = neutral.rho.iter().zip(places).map(reading).collect();
    for colour in Colour::ALL {
        let c = colour.index();
        let means = mean_readings(shots, &brightness, c);
        channel(neutral, &means, colour, &mut fitted, &mut readings)?;
    }
    fitted.patches = readings;
    if !exposures.is_empty() {
        let found = exposures::linearity(exposures)?;
        // Patches show as much of it as there is at their levels.
        let by_patches = if neutral.rho.len() < LEAST { [0.0; 3] } else { fitted.linearity };
        fitted.linearity = [0, 1, 2].map(|c| found[c].max(by_patches[c]));
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
fn mean_readings(shots: &[PatchShot], brightness: &[[f64; 3]], c: usize) -> Vec<RawReading> {
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
        patch.deviation[c] = reading.light / expected - 1.0;
        let own = libm::hypot(neutral.std_error * rho * k, reading.std_error) / expected;
        if patch.deviation[c].is_nan() || patch.deviation[c].abs() > NOT_LINEAR.max(3.0 * own) {
            let deviation = 100.0 * patch.deviation[c];
            return Err(Refusal::NotLinear { colour, patch: i + 1, rho, deviation });
        }
    }
    let gain = (of_white.light - glare.value * of_white.veil) / rho;
    let gain_error = libm::hypot(of_white.std_error, glare.std_error * of_white.veil) / rho;
    fitted.gain[c] = Estimate::new(gain, gain_error);
    fitted.glare[c] = glare;
    for (patch, reading) in patches.iter_mut().zip(readings) {
        let value = (reading.light - glare.value * reading.veil) / gain;
        patch.value[c] = Estimate::new(value, reading.std_error / gain);
    }
    // L = kρ + γM + qρ²: half-way, it deviates from the line through black and white by qρ/2.
    let curved =
        || regress(neutral, readings, c, true).map(|curve| (0.5 * rho * curve.x[2] / curve.x[0]).abs());
    fitted.linearity[c] =
        if readings.len() < LEAST { NOT_LINEAR } else { curved().unwrap_or(0.0).min(NOT_LINEAR) };
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
fn relative(shots: &[PatchShot]) -> Vec<[f64; 3]> {
    let light = |shot: &PatchShot| -> [f64; 3] {
        std::array::from_fn(|c| shot.readings.iter().map(|r| r[c].light).sum::<f64>())
    };
    let all: Vec<[f64; 3]> = shots.iter().map(light).collect();
    let mean: [f64; 3] = std::array::from_fn(|c| all.iter().map(|l| l[c]).sum::<f64>() / all.len() as f64);
    all.into_iter().map(|l| std::array::from_fn(|c| l[c] / mean[c])).collect()
}

fn check_drift(shots: &[PatchShot], brightness: &[[f64; 3]], fitted: &mut FittedLine) -> Result<(), Refusal> {
    for colour in Colour::ALL {
        let c = colour.index();
        let order = |a: &usize, b: &usize| brightness[*a][c].total_cmp(&brightness[*b][c]);
        let least = (0..shots.len()).min_by(order).unwrap_or(0);
        let most = (0..shots.len()).max_by(order).unwrap_or(0);
        let (first, last) = (least.min(most), least.max(most));
        let drift = brightness[last][c] / brightness[first][c] - 1.0;
        if drift.abs() > DRIFT {
            let (first, last) = (shots[first].label.clone(), shots[last].label.clone());
            return Err(Refusal::LightDrifted { colour, percent: 100.0 * drift, first, last });
        }
        fitted.drift[c] = drift;
    }
    Ok(())
}

fn light(shots: &[PatchShot], brightness: &[[f64; 3]], warnings: &mut Vec<Warning>) -> LampDrift {
    let n = shots.len() as f64;
    if shots.len() < 2 {
        warnings.push(Warning::NoDrift);
        return LampDrift { at: Vec::new(), std_error: [0.5 * DRIFT; 3], shots: 1 };
    }
    let std_error = std::array::from_fn(|c| {
        (brightness.iter().map(|b| (b[c] - 1.0).powi(2)).sum::<f64>() / (n - 1.0)).sqrt()
    });
    let times: Option<Vec<f64>> = shots.iter().map(|s| s.seconds).collect();
    let Some(times) = times else {
        warnings.push(Warning::NoTimes);
        return LampDrift { at: Vec::new(), std_error, shots: shots.len() };
    };
    let mut at: Vec<_> = times.into_iter().zip(brightness.iter().copied()).collect();
    at.sort_by(|a, b| a.0.total_cmp(&b.0));
    at.dedup_by(|later, earlier| later.0 <= earlier.0);
    LampDrift { at, std_error, shots: shots.len() }
}

/// Refuses brightness that follows a power of ρ other than the first. Patches in the wrong order follow no power.
fn check_gamma(neutral: &Neutral, shot: &PatchShot) -> Result<(), Refusal> {
    // Stray light is a large part of black patches.
    let sound = neutral.rho.iter().zip(&shot.readings).filter(|(rho, _)| rho[1] > BLACK);
    let points: Vec<[f64; 2]> =
        sound.map(|(rho, reading)| [libm::log(rho[1]), libm::log(reading[1].light.max(1e-3))]).collect();
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
