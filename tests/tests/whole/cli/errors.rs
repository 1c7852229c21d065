//! Messages of `farmctl` for bad input and a bad environment, and the files that it leaves behind.

use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::process::Command;

use farm_tests::cli::{GRID, HEAD, begin_to_submit, fails, fails_line, farm, folder, rows, run_line, write};
use farm_tests::process::{Ran, copied_program, program, run};

#[test]
fn scene_file_describes_any_stack() {
    let dir = folder();
    let scene = "[sensor]\nwidth_mm = 4\npixels = 8\n[[channel]]\nname = 'K'\nrho_light = 0.8\nrho_dark = 0\n\
                 [[layer]]\nname = 'resin'\nsample = true\nroughness = 0.1\n";
    write(dir.path(), "scene.toml", scene);
    let simulate = "simulate --sigma-t 6 --albedo 0.9 --g 0 --thickness 0.5 --walks 5000 --scene scene.toml";
    let ran = run_line(dir.path(), simulate);
    assert_eq!((ran.code, ran.stdout.lines().count()), (0, 9), "{}", ran.stderr);
}

/// Parameters out of range are refused with the field, the value and the range.
#[test]
fn bad_parameters_are_refused_with_their_range() {
    let dir = folder();
    let usual = "simulate --sigma-t 6 --albedo 0.9 --thickness 0.5 --walks 5000";
    for (change, message) in [
        ("--g 1", "g = 1 is not valid: allowed are -0.999 to 0.999"),
        ("--g 0 --sample-ior 0.5", "sample_ior = 0.5 is not valid"),
        ("--g 0 --pixels 0", "pixels = 0 is not valid"),
        ("--g 0 --width inf", "width_mm = inf is not valid"),
        ("--g 0 --rho-light 2 --rho-dark 0", "rho_light = 2 is not valid"),
    ] {
        fails_line(dir.path(), &format!("{usual} {change}"), &[message]);
    }
    let alone = run_line(dir.path(), &format!("{usual} --g 0 --rho-light 0.9"));
    assert_eq!(alone.code, 2, "{}", alone.stderr);
}

/// Bad grids are refused, with the line of the value, and leave nothing behind. The messages themselves are tested in
/// `optics-model` and in `farm-lab`.
#[test]
fn bad_grids_leave_nothing_behind() {
    let dir = folder();
    write(dir.path(), "scene.toml", "[light]\nring_deg = [50, 40]\n[[layer]]\nname = 's'\nsample = true\n");
    for (grid, message) in [
        ("scene = 'scene.toml'", "scene.toml, line 2: light.ring_deg = [50, 40] is not valid: two angles"),
        ("albedo = [\n  0.5,\n  1.5,\n]", "grid file bad.toml, line 3: albedo[1] = 1.5 is not valid"),
        ("colour = 'red'", "unknown field `colour`"),
        ("scene = 'none.toml'", "none of \"lab\", \"paper\", \"smooth\", and no file"),
    ] {
        write(dir.path(), "bad.toml", grid);
        fails(dir.path(), &["submit", "bad.toml"], &["bad.toml", message]);
    }
    fails(dir.path(), &["submit", "none.toml"], &["grid file none.toml", "No such file"]);
    write(dir.path(), "grid.toml", GRID);
    fails(dir.path(), &["submit", "grid.toml", "--name", "../x"], &["name = \"../x\" is not valid"]);
    assert!(!dir.path().join("farm-data").exists(), "a refused submission must not make a data directory");
}

/// The messages themselves are tested where they are made: of files in `farm-lab`, of fits in `optics-fit`, of settings in
/// `optics-model`.
#[test]
fn bad_measurements_are_refused() {
    let farm = farm();
    let dir = farm.path();
    let good = rows("R", 0.5);
    for (text, message) in [
        ("material,channel,x_mm,value\n".to_owned() + &good, "missing column thickness_mm"),
        (HEAD.to_owned() + &rows("X", 0.5), "channel = X is not valid: the dictionary has R, G, B"),
    ] {
        write(dir, "m.csv", &text);
        fails(dir, &["fit", "m.csv", "--dictionary", "grid"], &[message]);
    }
    write(dir, "m.csv", &(HEAD.to_owned() + &good));
    // The only dictionary needs no name.
    assert_eq!(run(dir, &["fit", "m.csv"]).code, 0);
    for (verb, option, message) in [
        ("fit", "--sigma-t=50..", "sigma_t_per_mm = 50 to inf is not valid: the dictionary has"),
        ("scale", "--mu-min=2", "mu_min = 2 to 1.1 is not valid: the lower bound must not exceed the upper"),
        ("measure", "--mu=-1", "mu = -1 is not valid"),
        ("map", "--channel=X", "material resin has no channel X; it has R"),
        ("map", "--material=x", "the file has no material x; it has resin"),
    ] {
        fails(dir, &[verb, "m.csv", "--dictionary", "grid", option], &[message]);
    }
    assert_eq!(run(dir, &["fit", "m.csv", "--g", "1..x"]).code, 2);
}

/// Values of the set-up that are out of range are refused with their field, by every command that fits.
#[test]
fn invalid_set_up_values_are_refused() {
    let dir = folder();
    let dir = dir.path();
    write(dir, "m.csv", &(HEAD.to_owned() + &rows("R", 0.5)));
    write(dir, "s.json", "{\"format\": \"farmctl-session/1\", \"gain_std_error\": 2}");
    for verb in ["fit", "scale", "measure", "map"] {
        fails(dir, &[verb, "m.csv", "--blur-mm=25"], &["blur_mm = 25 is not valid: allowed are 0 to 1"]);
        let message = "session file s.json: gain_std_error = 2 is not valid: allowed are 0 to 1";
        fails(dir, &[verb, "m.csv", "--session", "s.json"], &[message]);
    }
    assert_eq!(run(dir, &["fit", "m.csv", "--objective", "best"]).code, 2);
    fails(dir, &["fit", "m.csv", "--session", "none.json"], &["session file none.json: No such file"]);
}

/// Questions without a farm name the command to start with, and do not create a farm.
#[test]
fn questions_without_a_farm_suggest_submit() {
    let dir = folder();
    write(dir.path(), "m.csv", &(HEAD.to_owned() + &rows("R", 0.5)));
    for verb in [&["status"][..], &["list"], &["show", "paper"], &["export", "paper"], &["fit", "m.csv"]] {
        fails(dir.path(), verb, &["there is no farm in farm-data: run `farmctl submit` first"]);
    }
    let message = "no coordinator answers at http://127.0.0.1:9: nothing listens there (connection refused)";
    fails_line(dir.path(), "list --server http://127.0.0.1:9", &[message]);
    let message = "no machine is known by the name no-such-host.invalid";
    fails_line(dir.path(), "export paper --server http://no-such-host.invalid:7700", &[message]);
    assert!(!dir.path().join("farm-data").exists());
}

/// The advice for a folder without a coordinator does not mention farm-worker.
#[test]
fn explain_suggests_submit_in_an_idle_folder() {
    let dir = folder();
    write(dir.path(), "long.toml", GRID);
    let line = begin_to_submit(dir.path(), "long.toml");
    assert!(line.starts_with("long: 0.0 % of the work, 0 of 8 records"), "{line}");
    let explained = run(dir.path(), &["explain", "long"]);
    assert_eq!(explained.code, 0, "{}", explained.stderr);
    let expected =
        "the command that computed it has ended: `farmctl submit` with the same grid file and name";
    assert!(explained.stdout.contains(expected), "{}", explained.stdout);
    assert!(!explained.stdout.contains("farm-worker"), "{}", explained.stdout);
}

/// All programs refuse a log filter that is not valid.
#[test]
fn all_programs_refuse_a_wrong_log_filter() {
    let dir = folder();
    for (name, args) in [
        ("farmctl", &["list"][..]),
        ("farm-coordinator", &["--listen", "127.0.0.1:0", "--data", "data"]),
        ("farm-worker", &["--server", "http://127.0.0.1:9"]),
    ] {
        let mut command = Command::new(program(name));
        command.current_dir(dir.path()).args(args).env("FARM_LOG", "verbose");
        let ran: Ran = command.output().unwrap().into();
        assert_eq!(ran.code, 1, "{name}: {}", ran.stderr);
        assert!(ran.stderr.starts_with(&format!("{name}: FARM_LOG=`verbose`: ")), "{}", ran.stderr);
    }
    assert!(!dir.path().join("data").exists());
}

/// If the tests run as root, which ignores permissions, the command runs as user `nobody`.
#[test]
fn unwritable_data_folder_is_refused() {
    let dir = folder();
    let data = dir.path().join("data");
    std::fs::create_dir(&data).unwrap();
    std::fs::set_permissions(dir.path(), std::fs::Permissions::from_mode(0o755)).unwrap();
    std::fs::set_permissions(&data, std::fs::Permissions::from_mode(0o555)).unwrap();
    let mut command = Command::new(copied_program("farmctl", dir.path()));
    command.args(["submit", "--data"]).arg(&data).current_dir(dir.path());
    if std::fs::write(data.join("probe"), "").is_ok() {
        std::fs::remove_file(data.join("probe")).unwrap();
        command.uid(65_534);
    }
    let ran: Ran = command.output().unwrap().into();
    assert_eq!(ran.code, 1, "{}", ran.stderr);
    assert!(ran.stderr.contains("cannot be written to: Permission denied"), "{}", ran.stderr);
    assert_eq!(std::fs::read_dir(&data).unwrap().count(), 0);
    let message = "data directory /dev/null/farm: cannot be created";
    fails_line(dir.path(), "submit --data /dev/null/farm", &[message]);
}

/// A file in place of the database that is not a database is refused and left unchanged.
#[test]
fn foreign_database_file_is_left_alone() {
    let dir = folder();
    let file = dir.path().join("farm-data/farm.db");
    std::fs::create_dir(dir.path().join("farm-data")).unwrap();
    std::fs::write(&file, "this is a letter, not a database; it is long enough to be looked at closely")
        .unwrap();
    fails(dir.path(), &["list"], &["farm.db", "file is not a database"]);
    assert!(std::fs::read_to_string(&file).unwrap().starts_with("this is a letter"));
}

/// The coordinator and the worker report a failed start in one line.
#[test]
fn other_programs_report_errors_in_one_line() {
    let dir = folder();
    let first_line = |name: &str, args: &[&str]| {
        let ran: Ran =
            Command::new(program(name)).current_dir(dir.path()).args(args).output().unwrap().into();
        assert_eq!((ran.code, ran.stderr.lines().count()), (1, 1), "{}", ran.stderr);
        ran.stderr
    };
    let open = first_line("farm-coordinator", &["--listen", "0.0.0.0:0"]);
    assert!(
        open.contains("can be reached from other machines, unencrypted and without a password"),
        "{open}"
    );
    let data = first_line("farm-coordinator", &["--listen", "127.0.0.1:0", "--data", "/dev/null/farm"]);
    assert!(data.starts_with("farm-coordinator: data directory /dev/null/farm: cannot be created"), "{data}");
    let url = first_line("farm-worker", &["--server", "not a url"]);
    assert!(url.contains("\"not a url\" must begin with https:// or http://"), "{url}");
}
