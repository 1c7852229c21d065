use super::*;

fn measurement(channels: &[(&str, ProfileSetup)]) -> Measurement {
    let x: Vec<f64> = (0..8).map(f64::from).collect();
    let profile = |(channel, setup): &(&str, ProfileSetup)| {
        MeasuredProfile::new(*channel, 0.5, x.clone(), x.clone(), None).unwrap().with_setup(*setup).unwrap()
    };
    Measurement::new("white", channels.iter().map(profile).collect()).unwrap()
}

fn session(text: &str) -> tempfile::NamedTempFile {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), text).unwrap();
    file
}

const SESSION: &str = r#"{"format": "farmctl-session/1", "gain_std_error": 0.01, "thickness_std_error_mm": 0.002,
                          "blur_mm": {"R": 0.025, "G": 0.024}, "blur_std_error_mm": 0.001}"#;

/// Values of a measurement take precedence over the command line, and this over the session file.
#[test]
fn set_up_precedence_is_measurement_first() {
    let file = session(SESSION);
    let given = Session {
        gain_std_error: Some(ByChannel::All(0.02)),
        origin_std_error_mm: Some(ByChannel::All(0.004)),
        ..Session::default()
    };
    let set_up = SetUp::new(Some(file.path()), given.clone()).unwrap();
    let default = FitSettings::default();
    let expected = FitSettings {
        gain_std_error: 0.02,
        thickness_std_error_mm: 0.002,
        origin_std_error_mm: 0.004,
        blur_std_error_mm: 0.001,
        ..default
    };
    assert_eq!(set_up.settings(default), expected);
    let own = ProfileSetup { blur_mm: Some(0.05), ..ProfileSetup::default() };
    let none = ProfileSetup::default();
    let values = set_up.apply_to(vec![measurement(&[("R", none), ("G", own), ("B", none)])]).unwrap();
    let blur: Vec<_> = values[0].profiles().iter().map(|p| p.setup().blur_mm).collect();
    assert_eq!(blur, [Some(0.025), Some(0.05), None]);
    // The command line's blur applies to all channels.
    let given = Session { blur_mm: Some(ByChannel::All(0.04)), ..given };
    let set_up = SetUp::new(Some(file.path()), given).unwrap();
    assert_eq!(set_up.settings(default).blur_mm, 0.04);
    let measured = vec![measurement(&[("R", none), ("G", own)])];
    assert_eq!(set_up.apply_to(measured.clone()).unwrap(), measured);
}

#[test]
fn defaulted_quantities_are_listed_as_assumed() {
    let nothing = ProfileSetup::default();
    let some = ProfileSetup {
        thickness_std_error_mm: Some(0.001),
        origin_std_error_mm: Some(0.01),
        blur_mm: Some(0.02),
        ..nothing
    };
    let [gain, offset, slope, blur] = [0.003, 0.001, 0.002, 0.0].map(|value| Some(ByChannel::All(value)));
    let exact_light = Session {
        gain_std_error: gain,
        offset_std_error: offset,
        slope_std_error: slope,
        wedge_std_error: blur.clone(),
        blur_std_error_mm: blur,
        ..Session::default()
    };
    for (given, setup, expected) in [
        (
            Session::default(),
            nothing,
            Some(
                "assumed: thickness ± 0.005 mm, origin ± 0.05 mm, blur unknown up to 0.03 mm, gain ± 0.3 %, zero ± 0.001, \
                 slope ± 0.2 % per 10 mm, wedge ± 4 % per 10 mm",
            ),
        ),
        (
            Session::default(),
            some,
            Some(
                "assumed: blur ± 0.03 mm, gain ± 0.3 %, zero ± 0.001, slope ± 0.2 % per 10 mm, wedge ± 4 % per 10 mm",
            ),
        ),
        (exact_light.clone(), some, None),
        (exact_light, nothing, Some("assumed: thickness ± 0.005 mm, origin ± 0.05 mm")),
    ] {
        let set_up = SetUp::new(None, given).unwrap();
        let mut exact = ProfileSetup::default();
        exact.values_mut().for_each(|(_, value)| *value = Some(0.0));
        let assumed = set_up.assumed(&[measurement(&[("R", exact), ("G", setup)])]);
        assert_eq!(assumed.text(&set_up.settings(FitSettings::default())).as_deref(), expected);
    }
}
