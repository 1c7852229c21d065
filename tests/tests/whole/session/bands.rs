//! From photographs through band-pass filters to spectra of media.
//!
//! A monochrome camera photographs white and magenta; g falls with wavelength, and the lens has lateral colour and is
//! sharpest in the green. With `FARM_TEST_EFFORT=10` there are 8 bands and the paper's whole grid, with 40 there are 31
//! bands and five materials: 868 photographs, 300 MB.

use std::path::Path;

use farm_tests::cli::{folder, json, set_axes};
use farm_tests::coverage::{Answer, Coverage, media_table};
use farm_tests::dng::dng;
use farm_tests::photograph::{BandSession, Camera, EXAMPLE_NM, SpectralMaterial, spectral_nm};
use farm_tests::process::run;
use farm_tests::statistics::effort;
use optics_capture::{Frame, Pattern};
use serde_json::Value;

use super::{captured, measured, read_json};

/// Nodes of the short form's dictionary, whose responses are traced at three extinctions.
const AXES: &str = "sigma_t_per_mm = [2.5, 4.0, 4.5, 5.1, 5.8, 6.6, 7.5, 11.0]\ng = [0.2, 0.3, 0.4, 0.5, 0.6]\n\
    albedo = [0.94, 0.95, 0.96, 0.97, 0.98, 0.99, 0.995, 0.997, 0.998, 0.999, 0.9995]\nwalks = 30000\n";

/// Writes and captures a session into the folder `out`.
fn capture(session: &BandSession, folder: &Path) -> Value {
    session.write(folder).unwrap();
    json(&captured(folder, &["--json"]), "capture")
}

/// Blur, lateral colour and ρ of each band are those of the simulated lens and board.
fn check_optics(session: &BandSession, folder: &Path) {
    let found = read_json(&folder.join("out/session.json"));
    for (nm, band) in session.wavelengths_nm.iter().zip(found["bands"].as_array().unwrap()) {
        let number = |path: &str| band.pointer(path).and_then(Value::as_f64).unwrap_or(f64::NAN);
        let (lens_mm, magnification) = BandSession::lens(*nm);
        let blur_mm = libm::hypot(lens_mm, 1.0 / 26.0 / 12_f64.sqrt());
        let found_mm = found["blur_mm"][nm.to_string()].as_f64().unwrap();
        assert!((found_mm / blur_mm - 1.0).abs() < 0.02, "{nm}: blur {found_mm} for {blur_mm}");
        let reference =
            found["bands"].as_array().unwrap().iter().find(|b| b["is_reference"] == true).unwrap();
        let (_, of_reference) = BandSession::lens(reference["wavelength_nm"].as_f64().unwrap());
        let lateral = number("/magnification") - (magnification / of_reference - 1.0);
        assert!(lateral.abs() < 5e-5, "{nm}: magnification off by {lateral}");
        for (side, rho) in ["light", "dark"].iter().zip(BandSession::rho(*nm)) {
            let found = number(&format!("/board/rho_{side}/{nm}/value"));
            assert!((found / rho - 1.0).abs() < 0.015, "{nm}: rho {side} {found} for {rho}");
        }
    }
}

/// Prints estimates and truth.
fn answers(data: &Value, session: &BandSession) -> Vec<Answer> {
    let mut answers = Vec::new();
    for material in data["materials"].as_array().unwrap() {
        let name = material["material"].as_str().unwrap();
        let truth = session.materials.iter().find(|m| m.name == name).unwrap();
        answers.extend(material["channels"].as_array().unwrap().iter().map(|channel| {
            let nm = channel["channel"].as_str().unwrap();
            Answer::new(format!("{name} {nm}"), &truth.at(nm.parse().unwrap()), channel["refined"].clone())
        }));
    }
    println!("{}", media_table(&answers, &[0, 1, 2, 3, 4]));
    answers
}

/// The spectra of both media hold the truth, and g is a curve; one g for all wavelengths misleads.
#[test]
fn bands_become_spectra() {
    let is_long = effort() >= 10;
    let (wavelengths, materials) = match effort() {
        40.. => (spectral_nm(), 5),
        10..40 => (EXAMPLE_NM.to_vec(), 2),
        _ => (vec![470.0, 630.0], 2),
    };
    let walks = if is_long { 8_000_000 } else { 1_000_000 };
    let materials = SpectralMaterial::ALL[..materials].to_vec();
    let session = BandSession { walks, materials, ..BandSession::small(&wavelengths, 1) };
    let folder = folder();
    let data = capture(&session, folder.path());
    let slabs = 2 * session.materials.len();
    assert_eq!(data["profiles"].as_array().unwrap().len(), slabs * wavelengths.len());
    assert_eq!(data["profiles"][0]["channel"], wavelengths[0].to_string());
    check_optics(&session, folder.path());
    if !is_long {
        set_axes(&folder.path().join("out/grid.toml"), AXES);
    }
    let data = measured(folder.path(), &["-o", "media"]);
    let found = answers(&data, &session);
    assert_eq!((&data["common"]["g"], data["common"]["g_change"].as_f64()), (&Value::Null, Some(0.1)));
    let held = |answers: &[Answer], q: usize| Coverage::of_media([answers], &[q]).count();
    assert!((0..5).all(|q| 4 * held(&found, q) >= 3 * found.len()), "too few of {} hold", found.len());
    let media = std::fs::read_to_string(folder.path().join("media/media.xml")).unwrap();
    assert!(media.contains("g differs between wavelengths") && media.contains("<spectrum"), "{media}");
    let one_g = measured(folder.path(), &["--g-change", "0"]);
    assert!(one_g["common"]["g"].as_f64().is_some());
    let misled = held(&answers(&one_g, &session), 0);
    assert!(misled < held(&found, 0), "with one g, {misled} intervals of σ_t hold");
}

/// A mosaic that is read as a monochrome camera's pictures is refused, in a file of its kind and in one without kind.
#[test]
fn mosaics_are_not_monochrome() {
    let session = BandSession {
        materials: SpectralMaterial::ALL[..1].to_vec(),
        walks: 20_000,
        ..BandSession::small(&[550.0], 1)
    };
    let folder = folder();
    session.write(folder.path()).unwrap();
    // Pixels of green are twice as bright as the others.
    let file = "550_chart_1.dng";
    let chart = farm_lab::photograph::read(&folder.path().join(file)).unwrap().0;
    let brighter = |(i, v): (usize, &u16)| {
        let (x, y) = (i % chart.width, i / chart.width);
        if (x + y) % 2 == 1 { v + (v - 64) / 2 } else { *v }
    };
    let samples: Vec<u16> = chart.samples.iter().enumerate().map(brighter).collect();
    let photo = |pattern: Pattern| optics_capture::Photo {
        label: String::new(),
        frame: Frame::new(chart.width, chart.height, pattern, samples.clone()).unwrap(),
        levels: optics_capture::Levels { black: chart.black, white: chart.white },
        seconds: Some(120.0),
        exposure: Some(optics_capture::Exposure { time_s: 0.05, f_number: Some(11.0), iso: Some(100.0) }),
    };
    let refused = |message: &str| {
        let ran = run(folder.path(), &["capture", "session.toml", "-o", "out"]);
        assert_eq!(ran.code, 1, "{}", ran.stdout);
        let text = ran.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(text.contains(message) && text.contains("band \"550\""), "{text}");
    };
    std::fs::remove_file(folder.path().join("550_chart_after_1.dng")).unwrap();
    std::fs::write(folder.path().join(file), dng(&photo(Pattern::MONOCHROME))).unwrap();
    refused("pixels side by side differ in brightness by 50 %: this looks like a mosaic of colours");
    let colours = [
        optics_capture::Colour::Red,
        optics_capture::Colour::Green,
        optics_capture::Colour::Green,
        optics_capture::Colour::Blue,
    ];
    std::fs::write(folder.path().join(file), dng(&photo(Pattern::Bayer(colours)))).unwrap();
    refused("it has a mosaic of colours: set `channel` of the band to \"R\", \"G\" or \"B\"");
}

/// One colour of a mosaic gives the profiles of a monochrome camera, with the noise of fewer pixels.
#[test]
fn colour_cameras_record_bands() {
    let profiles = |channel: Option<&'static str>| {
        let materials = SpectralMaterial::ALL[..1].to_vec();
        let mono = BandSession { walks: 50_000, materials, ..BandSession::small(&[550.0], 1) };
        let camera = Camera { monochrome: channel.is_none(), ..mono.camera.clone() };
        let folder = folder();
        capture(&BandSession { camera, channel, ..mono }, folder.path())["profiles"].clone()
    };
    let [mono, green, red] = [None, Some("G"), Some("R")].map(profiles);
    let number = |profiles: &Value, slab: usize, field: &str| profiles[slab][field].as_f64().unwrap();
    for (other, share) in [(&green, 0.5_f64), (&red, 0.25)] {
        for slab in 0..2 {
            for field in ["dark", "light"] {
                let [one, two] = [&mono, other].map(|profiles| number(profiles, slab, field));
                assert!((one / two - 1.0).abs() < 1e-3, "{field}: {one} {two}");
            }
            let noise = number(other, slab, "noise") / number(&mono, slab, "noise");
            assert!((noise * share.sqrt() - 1.0).abs() < 0.1, "{share} of the pixels: noise {noise}");
        }
    }
}
