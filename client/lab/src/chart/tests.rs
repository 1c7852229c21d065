use std::fmt::Write as _;

use optics_chart::lab;
use optics_layers::{Print, PrintLayer};
use optics_model::Medium;
use optics_model::phase::PhaseShape;

use super::*;
use crate::media_file::MediaFile;

/// White, cyan and yellow: σ_s(1 − g) and σ_a in 1/mm of R, G and B.
const INKS: [(&str, [[f64; 2]; 3]); 3] = [
    ("white", [[7.0, 0.02], [8.5, 0.02], [10.0, 0.04]]),
    ("cyan", [[3.0, 2.8], [5.0, 0.7], [7.0, 0.06]]),
    ("yellow", [[6.0, 0.02], [8.0, 0.03], [7.0, 9.0]]),
];
const BASE: f64 = 0.6;
const NAMES: [&str; 3] = ["R", "G", "B"];

/// Radiance factors of stacks of these inks at 45:0, over a base.
struct Simulated(Print);

impl Simulated {
    fn new() -> Self {
        Self(Print::coarse(&PatchGeometry::default().scene().unwrap(), 1.5))
    }

    fn values(&self, stack: &[(usize, f64)], rho: f64) -> [f64; 3] {
        std::array::from_fn(|c| {
            let slab = |(ink, thickness_mm): &(usize, f64)| {
                let [scattering, absorption] = INKS[*ink].1[c];
                let sigma_t = scattering / 0.6 + absorption;
                let medium = Medium::new(sigma_t, scattering / 0.6 / sigma_t, 0.4).unwrap();
                PrintLayer { medium, phase: PhaseShape::default(), thickness_mm: *thickness_mm }
            };
            self.0.radiance_factors(&stack.iter().map(slab).collect::<Vec<_>>(), &[rho])[0] + 0.01
        })
    }
}

/// All stacks of three layers on white, with wedges.
fn stacks() -> Vec<Vec<(usize, f64)>> {
    let three = (0..27).map(|i| vec![(i / 9, 0.1), (i / 3 % 3, 0.1), (i % 3, 0.1), (0, 0.8)]);
    let wedges = (0..9).map(|i| vec![(i % 3, 0.1 * f64::from(1 << (i / 3 + 1))), (0, 0.8)]);
    three.chain(wedges).collect()
}

fn words(stack: &[(usize, f64)]) -> String {
    stack.iter().map(|(ink, mm)| format!("{}:{mm}", INKS[*ink].0)).collect::<Vec<_>>().join(" ")
}

/// A chart of colours, whose stacks may be written in another order than they were printed in.
fn colours(written: impl Fn(usize, &[Vec<(usize, f64)>]) -> Vec<(usize, f64)>) -> String {
    let (simulated, all) = (Simulated::new(), stacks());
    let mut text = "slabs,L,a,b\n".to_owned();
    for (i, stack) in all.iter().enumerate() {
        let [l, a, b] = lab(simulated.values(stack, BASE));
        writeln!(text, "{},{l:.2},{a:.2},{b:.2}", words(&written(i, &all))).unwrap();
    }
    text
}

fn parsed(text: &str) -> anyhow::Result<ChartFile> {
    ChartFile::parsed(text, ChartSettings::default())
}

fn codes(answer: &ChartAnswer) -> Vec<&'static str> {
    answer.data.notes.iter().map(|note| note.code).collect()
}

/// One patch in every form that tables have: separators, decimal commas, names of columns, colours and channels.
#[test]
fn tables_are_read_in_their_forms() {
    let values = |text: &str| {
        let file = parsed(text).unwrap();
        (stack_text(&file.patches[0].slabs), file.channels.join(" "), file.is_colour)
    };
    let stack = "white:0.08 cyan:0.16".to_owned();
    for text in [
        "slabs,L,a,b\nwhite:0.08 cyan:0.08 cyan:0.08,50,1,2\n",
        "# a chart\nStack;LAB_L;LAB_A;LAB_B\nwhite:0.08|cyan:0.16;50,0;1,0;2,0\n",
        "patch\tslabs\tL*\ta*\tb*\nA1\twhite:0.08 cyan:0.16\t50\t1\t2\nA2\twhite:0.08\tNA\t\t\n",
    ] {
        assert_eq!(values(text), (stack.clone(), "R G B".to_owned(), true), "{text}");
    }
    let tidy = "slabs,channel,value,std_error,base,geometry\n\
                white:0.08 cyan:0.16,460,0.5,0.01,black,d:8\nwhite:0.08 cyan:0.16,540,0.4,0.01,black,d:8\n";
    assert_eq!(values(tidy), (stack, "460 540".to_owned(), false));
    let file = parsed(tidy).unwrap();
    assert_eq!(file.patches.len(), 1);
    assert_eq!(
        (&file.patches[0].values[..], file.patches[0].geometry),
        (&[0.5, 0.4][..], Some(PatchGeometry::DiffuseEight))
    );
    // Repeated rows are further patches; a camera's channels are its colours.
    let twice = "slabs,channel,value\na:1,B,0.1\na:1,G,0.2\na:1,R,0.3\na:1,R,0.4\na:1,G,0.2\na:1,B,0.1\n";
    let file = parsed(twice).unwrap();
    assert_eq!((file.patches.len(), &file.patches[1].values[..]), (2, &[0.4, 0.2, 0.1][..]));
}

/// Tables of spectrophotometers with a column of stacks are charts, of wavelengths or of CIELAB.
#[test]
fn cgats_tables_are_charts() {
    let table = |columns: &str, row: &str| {
        format!(
            "CGATS.17\nNUMBER_OF_SETS 1\nBEGIN_DATA_FORMAT\n{columns}\nEND_DATA_FORMAT\nBEGIN_DATA\n{row}\nEND_DATA\n"
        )
    };
    let spectral =
        parsed(&table("SLABS SPECTRAL_NM460 SPECTRAL_NM540", "\"white:0.1 cyan:0.8\" 0.4 0.5")).unwrap();
    assert_eq!((spectral.channels.join(" "), spectral.is_colour), ("460 540".to_owned(), false));
    assert_eq!((&spectral.patches[0].values[..], spectral.patches[0].slabs.len()), (&[0.4, 0.5][..], 2));
    let colour = parsed(&table("SLABS LAB_L LAB_A LAB_B", "white:0.1|cyan:0.8 50 0 0")).unwrap();
    assert!(colour.is_colour && colour.patches[0].values.iter().all(|v| (v - 0.184_187).abs() < 1e-4));
    let error = format!("{:#}", parsed(&table("SLABS DENSITY", "a:1 2")).unwrap_err());
    assert!(error.contains("neither reflectances by wavelength nor LAB_L"), "{error}");
}

/// A chart of ChromaPrint3D with one stack.
fn color_db(recipe: &str, l: f64) -> String {
    format!(
        "{{\"base_channel_idx\": 0, \"base_layers\": 0, \"layer_height_mm\": 0.08, \"layer_order\": \"Top2Bottom\", \
         \"palette\": [{{\"color\": \"White\"}}], \"entries\": [{{\"lab\": [{l}, 0, 0], \"recipe\": {recipe}}}]}}"
    )
}

#[test]
fn wrong_charts_are_refused() {
    for (text, message) in [
        (
            "slabs,L,a\nwhite:1,50,1\n",
            "a chart has the columns slabs, L, a and b, or slabs, channel and value",
        ),
        (
            "slabs,L,a,b,dye\nwhite:1,50,1,2,3\n",
            "column \"dye\" is not known; the columns are slabs, channel",
        ),
        ("slabs,L,a,b\nwhite,50,1,2\n", "line 2: slab \"white\": MATERIAL:MM or"),
        ("slabs,L,a,b\nwhite:1,x,1,2\n", "line 2: l = \"x\" is no number"),
        ("slabs,L,a,b\nwhite:1,500,1,2\n", "is no colour in CIELAB"),
        ("slabs,L,a,b\nwhite=0.5,cyan=0.5:1,50,1,2\n", "line 2: it has 5 cells, the columns are 4"),
        ("slabs;L;a;b\nwhite=0.5,cyan=0.5:1;50;1;2\n", "slabs of a chart are of one material each"),
        ("slabs,L,a,b,row\nwhite:1,50,1,2,3\n", "line 2: row and column are given together"),
        ("slabs,channel,value\nwhite:1,R,52\n", "line 2: value = 52, std_error = 0: allowed are -0.1 to 3"),
        ("slabs,channel,value\nwhite:1,R,0.5\nwhite:2,G,0.5\n", "patch 1: it has 1 of the 2 channels R, G"),
        (
            "slabs,channel,value,geometry\nwhite:1,R,0.5,60\n",
            "geometry = \"60\" is not valid: allowed are 45:0",
        ),
        ("slabs,L,a,b\n", "it has 0 patches"),
        ("slabs,L,a,b\nwhite:1,,,\nwhite:2,NA,,\n", "none of its 2 patches has a colour: fill in L, a and b"),
        ("{\"palette\": [], \"recipe\": 1}", "missing field"),
        (&color_db("[]", 50.0), "it has 0 slabs in a stack"),
        (&color_db("[0]", 1e9), "entry 1: L = 1000000000"),
        (&color_db("[1]", 50.0), "entry 1: filament 1 is unknown"),
    ] {
        let error = format!("{:#}", parsed(text).unwrap_err());
        assert!(error.contains(message), "{text}: {error}");
    }
    for (text, message) in [
        ("values = \"a\"\nsample_ior = 5\n", "sample_ior = 5 is not valid"),
        ("values = \"a\"\ng = 1\n", "g = 1 is not valid: allowed are -0.9 to 0.9"),
        ("values = \"a\"\nbase = { R = 2 }\n", "base.R = 2 is not valid"),
        ("values = \"\"\n", "values is missing"),
        ("values = \"a\"\nheight = 1\n", "unknown field `height`"),
    ] {
        let error = format!("{:#}", ChartSettings::parsed(text, std::path::Path::new("c.toml")).unwrap_err());
        assert!(error.contains(message), "{text}: {error}");
    }
}

/// Without noise the media return: σ_s(1 − g) to 2 %, by an index that is given, and σ_a of what absorbs.
#[test]
fn media_of_a_chart_return() {
    let answer = measured(&parsed(&colours(|i, all| all[i].clone())).unwrap()).unwrap();
    for (fit, (name, truth)) in answer.fits.iter().zip(INKS) {
        assert_eq!(fit.material, name);
        for (channel, [scattering, absorption]) in fit.channels.iter().zip(truth) {
            let found = channel.refined.as_ref().unwrap();
            let medium = &found.best.medium;
            assert!(
                (medium.absorption_per_mm() - absorption).abs() < 0.02 + 0.03 * absorption,
                "{name} {medium:?}"
            );
            // One layer of yellow passes no blue: only their ratio shows.
            let room = if absorption > 5.0 { 0.15 } else { 0.03 };
            assert!(
                (medium.reduced_scattering_per_mm() / scattering - 1.0).abs() < room,
                "{name} {medium:?}"
            );
            assert!(found.reduced_scattering_per_mm.contains(scattering), "{name} {found:?}");
        }
    }
    let held_out = answer.data.held_out.as_ref().unwrap();
    assert!(held_out.below_95 < 0.5, "{held_out:?}");
    assert_eq!(codes(&answer), ["FEW_PATCHES", "ONE_LAYER_HEIGHT"]);
    assert_eq!(answer.media.chart.unwrap().layers_mm, [0.1]);
}

/// Stacks that are written from the base, or next to other colours, are not fitted in silence.
#[test]
fn wrong_orders_are_named() {
    let turned = |i: usize, all: &[Vec<(usize, f64)>]| {
        let mut stack = all[i].clone();
        let printed = stack.len() - 1;
        stack[..printed].reverse();
        stack
    };
    let answer = measured(&parsed(&colours(turned)).unwrap()).unwrap();
    assert!(codes(&answer).contains(&"UPSIDE_DOWN"), "{:?}", answer.data.notes);
    let shifted = |i: usize, all: &[Vec<(usize, f64)>]| all[(i + 1) % all.len()].clone();
    let answer = measured(&parsed(&colours(shifted)).unwrap()).unwrap();
    assert!(codes(&answer).contains(&"POOR_PREDICTION"), "{:?}", answer.data.notes);
}

/// Stacks that occur again are held out together: the same chart five times, with the same errors, predicts no better.
#[test]
fn repeated_stacks_are_held_out_together() {
    let (simulated, mut rows) = (Simulated::new(), String::new());
    for (i, stack) in stacks().iter().enumerate().take(24) {
        let [l, a, b] = lab(simulated.values(stack, BASE));
        // Errors of some units, which no medium has.
        let error = [-3.0, 2.0, 3.0, -2.0, 0.0][i * 7 % 5];
        writeln!(rows, "{},{:.2},{a:.2},{:.2}", words(stack), l + error, b - error).unwrap();
    }
    let [once, again] = [rows.clone(), rows.repeat(5)].map(|rows| {
        measured(&parsed(&format!("slabs,L,a,b\n{rows}")).unwrap()).unwrap().data.held_out.unwrap()
    });
    assert!(once.median > 1.5, "{}", once.median);
    assert!(again.median > 0.9 * once.median, "{} {}", once.median, again.median);
}

/// A patch at the end of a photograph's values is left out by name.
#[test]
fn clipped_patches_are_left_out() {
    let text = "slabs,channel,value\na:1,R,1\na:1,G,0.9\na:1,B,0.9\na:2,R,0.9\na:2,G,0.8\na:2,B,0.8\n";
    let file = parsed(text).unwrap();
    assert_eq!((file.patches.len(), file.notes[0].code), (1, "CLIPPED_PATCHES"));
    assert!(file.notes[0].text.contains("1 of 2 patches are left out") && file.notes[0].text.contains("(1)"));
    let file = parsed("slabs,channel,value\na:1,460,0\na:2,460,0.5\n").unwrap();
    assert!(file.patches.len() == 1 && file.notes[0].text.contains("is not above 0"), "{:?}", file.notes);
}

/// Media of edges as the prior: a chart narrows them, and g with them, as far as these errors were correlated.
#[test]
fn edges_and_charts_are_one_measurement() {
    let folder = tempfile::tempdir().unwrap();
    let channel = |c: usize| {
        let [scattering, absorption] = INKS[0].1[c];
        let sigma_t = scattering / 0.6 + absorption;
        // Along the valley of similar media: σ_t (1 − g) is known to 3 %, g to 20 % of 1 − g.
        let covariance = [[0.0409, 0.0, -0.04], [0.0, 1e-6, 0.0], [-0.04, 0.0, 0.04]];
        serde_json::json!({
            "channel": NAMES[c], "sigma_t_per_mm": 1.03 * sigma_t, "albedo": scattering / 0.6 / sigma_t, "g": 0.4,
            "sample_ior": 1.5, "covariance": covariance, "resolved": true, "misfit": 1.0,
            "sigma_t_interval": {}, "albedo_interval": {}, "g_interval": {}, "reduced_scattering_interval": {},
            "absorption_interval": {},
        })
    };
    let media = serde_json::json!({
        "format": "farmctl-media/1", "program": "test", "dictionary": "d", "dictionary_digest": "0", "mu": 1.0,
        "mu_std_error": 0.0, "scene": optics_model::SceneFile::from(&optics_model::Scene::lab()),
        "materials": [{"material": "white", "channels": [channel(0), channel(1), channel(2)]}],
    });
    std::fs::write(folder.path().join("media.json"), media.to_string()).unwrap();
    std::fs::write(folder.path().join("chart.csv"), colours(|i, all| all[i].clone())).unwrap();
    let measured_with = |extra: &str| {
        let path = folder.path().join("chart.toml");
        std::fs::write(&path, format!("values = \"chart.csv\"\nthickness_std_error = 0.0\n{extra}")).unwrap();
        measured(&ChartFile::read(&path).unwrap()).unwrap()
    };
    let (alone, both) = (measured_with(""), measured_with("media = \"media.json\"\n"));
    let channel = |answer: &ChartAnswer| answer.fits[0].channels[1].refined.clone().unwrap();
    let width = |i: &optics_model::fit::Interval| i.high - i.low;
    let (alone, both) = (channel(&alone), channel(&both));
    assert!(width(&both.reduced_scattering_per_mm) < width(&alone.reduced_scattering_per_mm));
    assert!(both.reduced_scattering_per_mm.contains(INKS[0].1[1][0]), "{both:?}");
    assert!(width(&both.g) < 0.5 * width(&alone.g) && both.g.contains(0.4), "{both:?}");
    // A chart whose thicknesses are known to 20 % makes media no worse that edges give to 3 %.
    let text = "values = \"chart.csv\"\nmedia = \"media.json\"\nthickness_std_error = 0.2\n";
    std::fs::write(folder.path().join("chart.toml"), text).unwrap();
    let coarse = channel(&measured(&ChartFile::read(&folder.path().join("chart.toml")).unwrap()).unwrap());
    let half =
        0.5 * width(&coarse.reduced_scattering_per_mm) / coarse.best.medium.reduced_scattering_per_mm();
    assert!((0.02..0.08).contains(&half), "{half}");
    assert!(coarse.reduced_scattering_per_mm.contains(INKS[0].1[1][0]), "{coarse:?}");
    // The result is a media file that others read.
    let text = measured_with("media = \"media.json\"\n").media.text().unwrap();
    MediaFile::from_json(serde_json::from_str(&text).unwrap()).unwrap();
    // An absorption that a chart found to be zero is not known to be zero.
    std::fs::write(folder.path().join("own.json"), text).unwrap();
    let own = measured_with("media = \"own.json\"\n");
    for (fit, (name, truth)) in own.fits.iter().zip(INKS) {
        for (channel, [_, absorption]) in fit.channels.iter().zip(truth) {
            let found = channel.refined.as_ref().unwrap().absorption_per_mm;
            assert!(found.contains(absorption), "{name} {} {found:?}", channel.channel);
        }
    }
    // None of its materials is in the chart.
    let other = media.to_string().replace("\"white\"", "\"black\"");
    std::fs::write(folder.path().join("media.json"), other).unwrap();
    std::fs::write(folder.path().join("chart.toml"), "values = \"chart.csv\"\nmedia = \"media.json\"\n")
        .unwrap();
    let file = ChartFile::read(&folder.path().join("chart.toml")).unwrap();
    assert!(
        measured(&file)
            .unwrap_err()
            .to_string()
            .contains("none of the chart's materials white, cyan, yellow")
    );
}

/// The light of a photograph is separated from the stacks where patches lie at random, and the media are those without it.
#[test]
fn uneven_light_is_divided_out() {
    let (simulated, mut text) = (Simulated::new(), "slabs,channel,value,row,column\n".to_owned());
    let all = stacks();
    for i in 0..72 {
        let stack = &all[i * 25 % all.len()];
        let (row, column) = (i / 9, i * 5 % 9);
        let light = 1.0 + 0.1 * (column as f64 / 4.0 - 1.0) - 0.05 * (row as f64 / 3.5 - 1.0);
        for (channel, value) in NAMES.into_iter().zip(simulated.values(stack, BASE)) {
            writeln!(text, "{},{channel},{:.5},{row},{column}", words(stack), light * value).unwrap();
        }
    }
    let answer = measured(&parsed(&text).unwrap()).unwrap();
    assert!((answer.data.light[0].range - 0.3).abs() < 0.03, "{:?}", answer.data.light);
    assert!(codes(&answer).contains(&"UNEVEN_LIGHT") && !codes(&answer).contains(&"SORTED_PLACES"));
    let white = answer.fits[0].channels[1].refined.as_ref().unwrap();
    assert!((white.best.medium.reduced_scattering_per_mm() / 8.5 - 1.0).abs() < 0.05, "{white:?}");
}
