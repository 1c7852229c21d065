//! Writes the folder of a session: profiles, set-up, scene, the grid of its dictionary, and the report.

use std::io::ErrorKind;
use std::path::Path;

use anyhow::{Context, Result, bail};
use optics_capture::{Colour, EdgeProfile, Estimate, LightChange, Source};
use optics_model::ProfileSetup;
use optics_model::grid::Axes;
use optics_model::{GridFile, SceneFile, SceneRef, scene::Channel};
use serde::Serialize;
use serde_json::{Map, Value, json};

use super::band_optics::BandOptics;
use super::budget::{SessionErrors, thickness_std_error_mm};
use super::captured::{Captured, CapturedPart, CapturedSample};
use super::channels::{CapturedChannel, profiles};
use super::report::{self, CaptureReport};
use super::stage::{board_channel, rounded, within_range};
use crate::measurement_file::{self, Note, column_names};
use crate::record::SessionRecord;
use crate::research_object::MEASURED_FILES;
use crate::slab_grid::dictionary_mm;
use crate::whole_file::{folder_of, sync_folder};

/// The files of a folder, in the order in which they are listed.
pub const FILES: [&str; 6] =
    ["measurements.csv", "session.json", "scene.toml", "grid.toml", "report.html", "report.json"];

/// Writes the folder: no file unless all can be generated, and each file atomically; removes what an earlier measurement
/// has written there. Returns the notes of reading its measurements back.
pub fn write_folder(folder: &Path, captured: &Captured) -> Result<Vec<Note>> {
    let measurements = measurements(captured)?;
    let read = measurement_file::read(&measurements)
        .context("profiles of these photographs (as in measurements.csv)")?;
    let report = CaptureReport::of(captured);
    let contents = [
        measurements,
        with_end(serde_json::to_string_pretty(&session(captured))?),
        with_end(scene(captured)?),
        with_end(grid(captured)?),
        report.page(None).into_bytes(),
        with_end(serde_json::to_string(&report)?),
    ];
    check_folder(folder)?;
    let place = || format!("writing {}", folder.display());
    let parent = folder_of(folder);
    std::fs::create_dir_all(parent).with_context(place)?;
    let draft = tempfile::Builder::new().prefix(".capture-").tempdir_in(parent).with_context(place)?;
    for (name, bytes) in FILES.iter().zip(contents) {
        let path = draft.path().join(name);
        std::fs::write(&path, bytes)
            .and_then(|()| std::fs::File::open(&path)?.sync_all())
            .with_context(place)?;
    }
    std::fs::create_dir_all(folder).with_context(place)?;
    // The media of an earlier measurement are not those of these profiles.
    for name in MEASURED_FILES {
        match std::fs::remove_file(folder.join(name)) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(error).with_context(place),
            _ => {}
        }
    }
    for name in FILES {
        std::fs::rename(draft.path().join(name), folder.join(name)).with_context(place)?;
    }
    sync_folder(folder).with_context(place)?;
    Ok(read.notes)
}

fn with_end(mut text: String) -> Vec<u8> {
    text.push('\n');
    text.into_bytes()
}

/// Refuses a folder with other files, which is probably a mistake, and files to replace that are not regular.
fn check_folder(folder: &Path) -> Result<()> {
    for path in FILES.iter().map(|name| folder.join(name)) {
        if path.metadata().is_ok_and(|found| !found.is_file()) {
            bail!("{} is no regular file: name another folder with --output", path.display());
        }
    }
    let Ok(entries) = std::fs::read_dir(folder) else { return Ok(()) };
    let mut entries = entries.peekable();
    if entries.peek().is_some() && !folder.join("session.json").exists() {
        bail!("{} holds other files: name a folder that does not exist yet with --output", folder.display());
    }
    Ok(())
}

/// The profiles in the strict format, with the set-up of each.
fn measurements(captured: &Captured) -> Result<Vec<u8>> {
    let mut rows = csv::WriterBuilder::new().comment(Some(b'#')).from_writer(Vec::new());
    rows.write_record(column_names())?;
    let channels = captured.channels();
    for (channel, sample) in profiles(&channels) {
        let (blur, profile) = (channel.blur_mm(), channel.profile(sample));
        let known = ProfileSetup {
            thickness_std_error_mm: Some(thickness_std_error_mm(channel, sample)),
            origin_mm: Some(0.0),
            origin_std_error_mm: Some(channel.error(sample, &[Source::Origin])),
            ..ProfileSetup::default()
        };
        let known =
            ProfileSetup { blur_mm: Some(blur.value), blur_std_error_mm: Some(blur.std_error), ..known };
        let set_up: Vec<String> =
            known.values().map(|(_, value)| value.map_or_else(String::new, cell)).collect();
        for [x, value, error] in points(profile) {
            let names = [sample.about.material.clone(), channel.name.clone()];
            let numbers = [
                sample.about.thickness_mm.to_string(),
                format!("{x:.6}"),
                format!("{value:.7}"),
                format!("{error:.7}"),
            ];
            rows.write_record(names.iter().chain(&numbers).chain(&set_up))?;
        }
    }
    Ok(rows.into_inner()?)
}

fn cell(value: f64) -> String {
    if value == 0.0 { "0".to_owned() } else { format!("{value:.6}") }
}

/// Bins from the first to the last with a value. A bin between them whose samples were all rejected gets the value of
/// the preceding bin and an error so large that it has no weight: profiles have no gaps.
fn points(profile: &EdgeProfile) -> Vec<[f64; 3]> {
    const NO_WEIGHT: f64 = 1.0;
    let all = profile.x_mm.iter().zip(&profile.values).zip(&profile.std_errors);
    let sound = |v: f64, e: f64| v.is_finite() && e.is_finite() && e > 0.0;
    let mut points: Vec<[f64; 3]> = Vec::new();
    for ((x, value), error) in all {
        match points.last() {
            _ if sound(*value, *error) => points.push([*x, *value, *error]),
            Some([_, before, _]) => points.push([*x, *before, NO_WEIGHT]),
            None => {}
        }
    }
    while points.last().is_some_and(|p| p[2] == NO_WEIGHT) {
        points.pop();
    }
    points
}

/// The session's scene with the measured board, and with the board as it would be under a darker white reference.
fn scene(captured: &Captured) -> Result<String> {
    let channels = captured.channels();
    let darker = channels.iter().map(|channel| {
        let rho = channel.rho();
        let found = [rho.light.value, rho.dark.value];
        // Where ρ is clamped, its change is kept.
        let change = [0, 1].map(|side| rho.under_darker_white[side] - found[side]);
        let within = within_range(found);
        let [light, dark] = within_range([within[0] + change[0], within[1] + change[1]]);
        Channel::new(Channel::darker_white(&channel.name), rounded(light), rounded(dark))
    });
    let found = channels.iter().map(|channel| board_channel(&channel.name, &channel.rho()));
    let channels = found.chain(darker).collect::<Result<Vec<_>, _>>().context("reflectances of the board")?;
    let scene = captured.session.scene.clone().with_channels(channels)?;
    Ok(format!(
        "# The scene of a session: `rho_light` and `rho_dark` are what its bare board shows. The channels called\n\
         # \"(white -1 %)\" have the board as it would be, were the white reference darker by 1 %: from these the fit\n\
         # computes the effect of an error of the reference.\n\n{}",
        toml::to_string(&SceneFile::from(&scene))?.trim_end()
    ))
}

/// The axes of `lab` with this session's thicknesses.
fn grid(captured: &Captured) -> Result<String> {
    let thicknesses = captured.parts[0].samples.iter().map(|sample| sample.about.thickness_mm);
    let file = GridFile {
        scene: SceneRef::Named("scene.toml".to_owned()),
        sigma_t_per_mm: None,
        albedo: Some(Axes::ALBEDO.to_vec()),
        g: None,
        thickness_mm: Some(dictionary_mm(thicknesses.collect())),
        sample_ior: None,
        walks: None,
        seed: None,
        derivatives: false,
        quality: None,
    };
    Ok(format!(
        "# The dictionary of a session, with the axes of `lab`. Slabs that are nearly alike, or\n\
         # near a nominal thickness, share one; the fit uses the measured thicknesses.\n\n{}",
        toml::to_string(&file)?.trim_end()
    ))
}

/// All results as numbers, for programs; the fit reads the fields at the top level.
pub(super) fn session(captured: &Captured) -> impl Serialize {
    #[derive(Serialize)]
    struct SessionJson {
        format: &'static str,
        #[serde(flatten)]
        errors: SessionErrors,
        #[serde(skip_serializing_if = "Value::is_null")]
        colours: Value,
        blur_mm: Value,
        blur_std_error_mm: Value,
        base_spread_mm: Value,
        /// Measured quantities of the scene.
        #[serde(flatten)]
        measured: Map<String, Value>,
        #[serde(flatten)]
        parts: Map<String, Value>,
        record: SessionRecord,
        inputs: Vec<Value>,
        digest: String,
    }
    let channels = captured.channels();
    let digest = blake3::hash(captured.session.text.as_bytes());
    let inputs =
        captured.inputs.iter().map(|input| json!({"photograph": input.label, "blake3": input.digest}));
    SessionJson {
        format: "farmctl-session/1",
        errors: SessionErrors::of(captured),
        colours: captured.session.colours.map_or(Value::Null, colours),
        blur_mm: by_channel(&channels, |c| json!(c.blur_mm().value)),
        blur_std_error_mm: by_channel(&channels, |c| json!(c.blur_mm().std_error)),
        base_spread_mm: best(captured, |part| Some(part.board.spread_mm)).unwrap_or_default(),
        measured: measured(captured),
        parts: parts(captured),
        record: captured.session.record.clone(),
        inputs: inputs.collect(),
        digest: digest.to_hex().to_string(),
    }
}

/// Mean wavelength and standard deviation of a camera's colours.
fn colours(colours: [(f64, f64); 3]) -> Value {
    let band = |(colour, (nm, std_dev)): (Colour, (f64, f64))| {
        (colour.letter().to_owned(), json!({"wavelength_nm": nm, "std_dev_nm": std_dev}))
    };
    Value::Object(Colour::ALL.into_iter().zip(colours).map(band).collect())
}

/// Shares of light that blue excites, of the colours in which a slab is bright enough.
fn fluorescence(shares: [Option<Estimate>; 2]) -> Value {
    let found = [Colour::Red, Colour::Green].into_iter().zip(shares);
    found.filter_map(|(colour, share)| Some((colour.letter().to_owned(), estimate(share?)))).collect()
}

/// A number of the session that may differ between bands: the mean with their scatter.
fn common(captured: &Captured, found: impl Fn(&CapturedPart) -> Option<Estimate>) -> Option<Value> {
    let all: Vec<Estimate> = captured.parts.iter().filter_map(found).collect();
    let n = all.len() as f64;
    let mean = |value: &dyn Fn(&Estimate) -> f64| all.iter().map(value).sum::<f64>() / n;
    let value = mean(&|e| e.value);
    let square = mean(&|e| e.std_error.powi(2)) + mean(&|e| (e.value - value).powi(2));
    (!all.is_empty()).then(|| estimate(Estimate::new(value, square.sqrt())))
}

/// A number of the session: of several bands that with the least error.
fn best(captured: &Captured, found: impl Fn(&CapturedPart) -> Option<Estimate>) -> Option<Value> {
    let all = captured.parts.iter().filter_map(found);
    all.min_by(|a, b| a.std_error.total_cmp(&b.std_error)).map(estimate)
}

/// Quantities of the scene that have shots of their own.
fn measured(captured: &Captured) -> Map<String, Value> {
    let found = [
        ("haze", common(captured, |part| part.haze)),
        ("light_side", common(captured, |part| part.light_side)),
    ];
    found.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?))).collect()
}

/// `board`, `camera` and `samples` of red, green and blue, or a list of these as `bands`.
fn parts(captured: &Captured) -> Map<String, Value> {
    let fields = |part: &CapturedPart| {
        let samples: Vec<Value> = part.samples.iter().map(|s| sample(part, s)).collect();
        let fields = [("board", board(part)), ("camera", camera(part)), ("samples", Value::Array(samples))];
        fields.map(|(name, value)| (name.to_owned(), value)).into_iter().collect::<Map<String, Value>>()
    };
    let optics = BandOptics::of(&captured.parts);
    if optics.is_empty() {
        return captured.parts.iter().flat_map(fields).collect();
    }
    let band = |(optics, part): (&BandOptics, &CapturedPart)| {
        let optics = serde_json::to_value(optics).unwrap_or_default();
        let own = optics.as_object().cloned().unwrap_or_default();
        Value::Object(own.into_iter().chain(fields(part)).collect())
    };
    let bands = optics.iter().zip(&captured.parts).map(band);
    Map::from_iter([("bands".to_owned(), Value::Array(bands.collect()))])
}

fn by_channel(channels: &[CapturedChannel], of: impl Fn(&CapturedChannel) -> Value) -> Value {
    Value::Object(channels.iter().map(|channel| (channel.name.clone(), of(channel))).collect())
}

fn estimate(e: Estimate) -> Value {
    json!({"value": e.value, "std_error": e.std_error})
}

fn board(part: &CapturedPart) -> Value {
    let (board, channels) = (&part.board, part.channels());
    let by_channel = |of: &dyn Fn(&CapturedChannel) -> Value| by_channel(&channels, of);
    json!({
        "mm_per_px": estimate(board.mm_per_px),
        "edge_angle_deg": estimate(board.edge.angle_deg),
        "edge_bend_px": estimate(board.edge.bend_px),
        "dark_side": board.edge.dark_side.to_string(),
        "corners_found": board.corners_px.len(),
        "seen_light": by_channel(&|c| estimate(board.light[c.column])),
        "seen_dark": by_channel(&|c| estimate(board.dark[c.column])),
        "rho_light": by_channel(&|c| estimate(c.rho().light)),
        "rho_dark": by_channel(&|c| estimate(c.rho().dark)),
        "warnings": report::texts(&board.warnings),
    })
}

fn camera(part: &CapturedPart) -> Value {
    let (calibration, channels) = (&part.calibration, part.channels());
    let by_channel = |of: &dyn Fn(&CapturedChannel) -> Value| by_channel(&channels, of);
    let about = &part.about;
    let areas =
        calibration.patches.iter().map(|p| [p.area.x, p.area.y, p.area.width, p.area.height].map(f64::round));
    let noise = calibration.noise.iter().map(|n| json!({"read": n.read.value, "per_number": n.gain.value}));
    json!({
        "model": about.camera.clone(),
        "exposure_s": about.exposure_s,
        "iso": about.iso,
        "f_number": about.f_number,
        "noise": noise.collect::<Vec<_>>(),
        "glare": by_channel(&|c| estimate(calibration.glare[c.column])),
        "numbers_per_unit": by_channel(&|c| estimate(calibration.gain[c.column])),
        "linearity": by_channel(&|c| json!(calibration.linearity[c.column])),
        "drift": by_channel(&|c| json!(calibration.drift[c.column])),
        "patches_px": areas.collect::<Vec<_>>(),
        "warnings": report::texts(&calibration.warnings),
    })
}

fn sample(part: &CapturedPart, sample: &CapturedSample) -> Value {
    let channels = part.channels();
    let by_channel = |of: &dyn Fn(&CapturedChannel) -> Value| by_channel(&channels, of);
    let line = |name: &str, unit: &str, of: &dyn Fn(&CapturedChannel) -> f64| {
        let errors = by_channel(&|c| json!(of(c)));
        (name.to_owned(), json!({"unit": unit, "std_error": errors}))
    };
    let thickness = line("thickness", "mm", &|_| sample.about.thickness_std_error_mm);
    let blur = line("blur", "mm", &|c| c.blur_mm().std_error);
    let sources = sample.profile.budget.iter().map(|of| of.source);
    let budget = sources.map(|source| line(source.name(), source.unit(), &|c| c.error(sample, &[source])));
    let light = sample.profile.shots.iter();
    let light = light.map(|shot| shot.light.as_ref().map(|light| by_channel(&|c| change(&light[c.column]))));
    json!({
        "material": sample.about.material,
        "thickness_mm": sample.about.thickness_mm,
        "shots": sample.profile.shots.iter().map(|shot| shot.label.clone()).collect::<Vec<_>>(),
        "light": light.collect::<Vec<_>>(),
        "fluorescence": sample.fluorescence.map(fluorescence),
        "budget": Value::Object(budget.chain([thickness, blur]).collect()),
        "warnings": report::texts(&sample.profile.warnings),
    })
}

fn change(light: &LightChange) -> Value {
    json!({
        "factor": estimate(light.factor),
        "offset": estimate(light.offset),
        "slope_per_10_mm": light.slope.map(estimate),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bin without samples is interpolated with a large error, so that the profile has no gap.
    #[test]
    fn empty_bin_is_interpolated_without_weight() {
        let nan = f64::NAN;
        let profile = EdgeProfile {
            colour: optics_capture::Colour::Red,
            x_mm: vec![-2.0, -1.0, 0.0, 1.0, 2.0],
            values: vec![nan, 0.1, nan, 0.3, nan],
            std_errors: vec![nan, 0.01, nan, 0.02, nan],
            counts: vec![0, 9, 0, 9, 0],
            rejected: vec![0.0; 5],
        };
        assert_eq!(points(&profile), [[-1.0, 0.1, 0.01], [0.0, 0.1, 1.0], [1.0, 0.3, 0.02]]);
    }

    /// A folder with other files is left alone.
    #[test]
    fn folder_with_other_files_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        assert!(check_folder(folder.path()).is_ok());
        std::fs::write(folder.path().join("thesis.tex"), "").unwrap();
        assert!(check_folder(folder.path()).unwrap_err().to_string().contains("holds other files"));
        std::fs::write(folder.path().join("session.json"), "").unwrap();
        assert!(check_folder(folder.path()).is_ok());
        let pipe = folder.path().join("scene.toml");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        assert!(check_folder(folder.path()).unwrap_err().to_string().contains("is no regular file"));
    }
}
