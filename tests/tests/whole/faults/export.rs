//! Exports whose stream is cut: they resume, or the command fails and reports how many records arrived.

use std::io::Read as _;
use std::process::{Child, Stdio};

use farm_tests::farm::Farm;
use farm_tests::process::{Ran, SOON, farmctl, wait_for};
use farm_tests::proxy::{Direction, Proxy};

use super::{GRID, RECORDS};

/// Bytes of the answer that pass before the link is cut: some of the records, of 9 kB each.
const PASSES: u64 = 100_000;

/// A farm whose dictionary is done, a proxy that holds back the rest of an export, and the export.
async fn cut_in_the_middle() -> (Farm, Proxy, Child) {
    let farm = Farm::start(&["--insecure"]);
    farm.submit("grid", GRID);
    let worker = farm.worker("worker", &[]);
    farm.done("grid");
    drop(worker);
    let proxy = Proxy::start(([127, 0, 0, 1], farm.port()).into()).await;
    proxy.hold_after(Direction::Answers, PASSES);
    let export = farmctl(farm.folder())
        .args(["export", "grid", "-o", "all.csv", "--server", &proxy.url()])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    wait_for("the export exceeds the limit", SOON, || (proxy.held_bytes() > 0).then_some(()));
    (farm, proxy, export)
}

fn ended(export: Child) -> Ran {
    export.wait_with_output().unwrap().into()
}

/// Drafts and finished files of the export.
fn files(farm: &Farm) -> Vec<String> {
    let names = std::fs::read_dir(farm.folder()).unwrap().map(|e| e.unwrap().file_name());
    names.map(|name| name.into_string().unwrap()).filter(|name| name.contains("all.csv")).collect()
}

/// An export over a link that breaks continues where it was.
#[tokio::test(flavor = "multi_thread")]
async fn export_resumes_after_a_broken_link() {
    let (farm, proxy, export) = cut_in_the_middle().await;
    // In this order: held bytes are lost with their connection, and later connections pass.
    proxy.cut();
    proxy.heal();
    let ran = ended(export);
    assert_eq!((ran.code, ran.stderr.as_str()), (0, ""));
    let whole = farm.farmctl(&["export", "grid"]);
    assert_eq!(std::fs::read_to_string(farm.folder().join("all.csv")).unwrap(), whole.stdout);
    assert!(proxy.accepted() > 1, "it connected again");
}

/// The message gives the number of records that arrived, and no part of the file is left.
#[tokio::test(flavor = "multi_thread")]
async fn export_fails_when_its_coordinator_is_gone() {
    let (mut farm, proxy, export) = cut_in_the_middle().await;
    farm.kill_coordinator();
    proxy.cut();
    let ran = ended(export);
    assert_eq!(ran.code, 1, "{}", ran.stderr);
    let message = ran.stderr.strip_prefix("farmctl: only ").unwrap_or_else(|| panic!("{}", ran.stderr));
    let (came, rest) = message.split_once(' ').unwrap();
    assert!((1..RECORDS).contains(&came.parse().unwrap()), "{message}");
    assert!(
        rest.starts_with(&format!("of {RECORDS} records came, run the same command again: ")),
        "{message}"
    );
    assert_eq!(files(&farm), Vec::<String>::new(), "neither a draft nor a part of a file is left");
}

/// 300 albedos at 42 points, of one channel and few pixels.
const MANY: &str = "\
sigma_t_per_mm = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21]
g = [0.4]
thickness_mm = [0.5, 1.0]
walks = 5000

[scene.sensor]
width_mm = 10.0
pixels = 8
[[scene.channel]]
name = 'mono'
rho_light = 0.9
rho_dark = 0.1
[[scene.layer]]
name = 'resin'
sample = true
";

/// An export may select more records than one call may name.
#[test]
fn export_may_need_more_than_one_call() {
    let farm = Farm::start(&[]);
    let albedos: Vec<String> = (1..=300).map(|i| format!("{}", f64::from(i) / 301.0)).collect();
    farm.submit("many", &format!("albedo = [{}]\n{MANY}", albedos.join(", ")));
    let _worker = farm.worker("worker", &[]);
    farm.done("many");
    let all = farm.farmctl(&["export", "many"]).stdout;
    let named = farm.farmctl(&["export", "many", "--g", "0.4"]);
    assert_eq!((named.code, named.stderr.as_str()), (0, ""));
    assert!(
        all.lines().count() > 12_600 && named.stdout == all,
        "{} lines of {}",
        named.stdout.lines().count(),
        all.lines().count()
    );
}

/// Arrays of the axes need only the records of the axes, not those of the responses.
#[test]
fn arrays_do_not_wait_for_responses() {
    let grid = |sigma_t: &str, gel_mm: &str| {
        format!(
            "sigma_t_per_mm = {sigma_t}\nalbedo = [0.9, 0.99]\ng = [0.4]\nthickness_mm = [1]\nwalks = 1000\n\
             [[scene.layer]]\nname = 'gel'\nior = 1.33\nthickness_mm = {gel_mm}\n\
             [[scene.layer]]\nname = 's'\nsample = true\n"
        )
    };
    let uncertain = "{ value = 0.02, std_error = 0.02 }";
    let farm = Farm::start(&["--insecure"]);
    farm.submit("exact", &grid("[4, 8]", "0.02"));
    let worker = farm.worker("worker", &[]);
    farm.done("exact");
    drop(worker);
    // Records do not depend on priors, so those of the axes exist already.
    farm.submit("varied", &grid("[4, 8]", uncertain));
    let varied = farm.listed("varied").unwrap();
    assert!(varied["records_done"] == 4 && varied["records_total"].as_u64() > Some(4), "{varied}");
    let values = |name: &str| {
        let file = format!("{name}.npz");
        let ran = farm.farmctl(&["export", name, "--npz", &file]);
        assert_eq!((ran.code, ran.stderr.as_str()), (0, ""), "{name}");
        let mut archive = zip::ZipArchive::new(std::fs::File::open(farm.path(&file)).unwrap()).unwrap();
        let mut bytes = Vec::new();
        archive.by_name("value.npy").unwrap().read_to_end(&mut bytes).unwrap();
        bytes
    };
    assert!(values("varied") == values("exact"));
    farm.submit("wider", &grid("[4, 6, 8]", uncertain));
    let refused = |args: &[&str], message: &str| {
        let ran = farm.farmctl(&[&["export", "--npz", "refused.npz"], args].concat());
        assert!(ran.code == 1 && ran.stderr.contains(message), "{}", ran.stderr);
        assert!(!farm.path("refused.npz").exists());
    };
    refused(&["wider"], "4 of 6 records are done: arrays have no place for what is missing");
    refused(&["varied", "--responses"], "record 4 is not done yet");
}
