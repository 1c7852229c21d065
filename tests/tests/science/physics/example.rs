//! The example measurement from grid to fit, as in the README.

use farm_tests::process::{LONG, Process, run, wait_for};
use farm_tests::reference::root;
use optics_model::{Grid, SceneFile};
use serde_json::Value;

/// All extinctions and albedos of the paper at g = 0.4, with 100,000 walks per point instead of 250,000: each channel
/// of the white material, rendered by Mitsuba, must come out within one grid step of the parameters it was rendered
/// with. The steps are 8 to 9 % in σ_t, and 0.0001 to 0.001 in α.
#[test]
fn white_example_is_recovered_within_one_step() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("grid.toml"), "g = [0.4]\nwalks = 100000\n").unwrap();
    let submitted = run(folder.path(), &["submit", "grid.toml", "-q"]);
    assert_eq!(submitted.code, 0, "{}", submitted.stderr);
    let file = root().join("examples/white.csv");
    let fitted =
        run(folder.path(), &["fit", file.to_str().unwrap(), "--dictionary", "grid", "--g", "0.4", "--json"]);
    assert_eq!(fitted.code, 0, "{}", fitted.stderr);
    let fitted: Value = serde_json::from_str(&fitted.stdout).expect("fit --json prints JSON");
    let truth = [("R", 6.0, 0.9991), ("G", 9.0, 0.9997), ("B", 24.0, 0.999)];
    let paper = Grid::paper();
    let place = |axis: &[f64], value: f64| axis.iter().position(|v| *v == value).unwrap().cast_signed();
    let channels = fitted["data"]["materials"][0]["channels"].as_array().unwrap();
    assert_eq!(channels.len(), truth.len());
    for ((channel, sigma_t, albedo), fit) in truth.into_iter().zip(channels) {
        assert_eq!(fit["channel"], channel);
        let best = &fit["candidates"][0];
        let (found_sigma_t, found_albedo) =
            (best["sigma_t_per_mm"].as_f64().unwrap(), best["albedo"].as_f64().unwrap());
        println!("{channel}: {found_sigma_t} {found_albedo}, rendered with {sigma_t} {albedo}");
        let sigma_t_steps =
            place(paper.sigma_t_per_mm(), found_sigma_t) - place(paper.sigma_t_per_mm(), sigma_t);
        let albedo_steps = place(paper.albedo(), found_albedo) - place(paper.albedo(), albedo);
        assert!(sigma_t_steps.abs() <= 1 && albedo_steps.abs() <= 1, "{channel}: {best}");
    }
}

/// The README's first command computes the paper's dictionary, resumes after a kill, and its intervals contain the
/// truth.
#[test]
fn one_command_measures_in_an_empty_folder() {
    let folder = tempfile::tempdir().unwrap();
    let file = root().join("examples/white.csv");
    let data = folder.path().join("farm-data");
    let args = ["measure", file.to_str().unwrap(), "--dictionary", "paper", "--data", data.to_str().unwrap()];
    let mut killed = Process::start("farmctl", &args, &folder.path().join("killed.log"));
    killed.wait_for_log("farmctl: paper: ");
    let first = data.join("farm.db-wal");
    wait_for("records are stored", LONG, || std::fs::metadata(&first).ok().filter(|log| log.len() > 1 << 20));
    killed.kill();
    assert!(killed.log().contains("34,276 of its 34,276 records are computed"), "{}", killed.log());
    let measured = run(folder.path(), &[&args[..], &["--json"]].concat());
    assert_eq!(measured.code, 0, "{}", measured.stderr);
    assert!(measured.stderr.contains(" of its 34,276 records are computed"), "{}", measured.stderr);
    assert!(!measured.stderr.contains("34,276 of its"), "stored records are kept: {}", measured.stderr);
    let measured: Value = serde_json::from_str(&measured.stdout).expect("measure --json prints JSON");
    let channels = measured["data"]["materials"][0]["channels"].as_array().unwrap();
    for (fit, (sigma_t, albedo)) in channels.iter().zip([(6.0, 0.9991), (9.0, 0.9997), (24.0, 0.999)]) {
        let interval = &fit["refined"]["absorption_interval"];
        let [low, high] = ["low", "high"].map(|end| interval[end].as_f64().unwrap());
        let truth = sigma_t * (1.0 - albedo);
        let open = interval["open_low"].as_bool().unwrap();
        assert!((open || low <= truth) && truth <= high, "{interval} does not hold {truth}");
    }
    assert_eq!(channels.len(), 3);
}

#[test]
fn example_grid_and_scene_are_valid() {
    let grid = farm_lab::grid_file::read_grid(&root().join("examples/grid.toml")).unwrap();
    assert!(grid.derivatives() && grid.record_count() < 1000);
    let scene =
        farm_lab::grid_file::read_scene(root().join("examples/scene.toml").to_str().unwrap()).unwrap();
    assert_eq!(scene, *grid.scene());
    // The scene file contains the paper's scene explicitly.
    assert_eq!(SceneFile::from(&scene).layers, SceneFile::from(Grid::paper().scene()).layers);
}
