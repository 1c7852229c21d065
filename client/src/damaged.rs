//! Tests all parsers of external input with damaged data: the result is an error in plain words or an answer, never a
//! panic.
//!
//! Sound files and messages are changed at random, as editors, transfers and attackers might change them. Each test
//! tries 300 cases by default; `PROPTEST_CASES=100000 cargo test --release -p farmctl damaged` tries more.

use std::path::Path;
use std::sync::OnceLock;

use farm_lab::capture::CaptureSession;
use farm_lab::grid_file::read_grid;
use farm_lab::measurement_file::read_measurements;
use farm_lab::mixture_file::read_mixtures;
use farm_lab::set_up;
use farm_link::{ClientAccess, CoordinatorAccess};
use farm_proto::wire;
use optics_model::fit::{DesignQuestion, FitOptions, MuRange};
use optics_model::grid::Axes;
use optics_model::job::JobSpec;
use optics_model::scene::{Scene, Sensor};
use optics_model::{Grid, Measurement, PackedRecords, Walks};
use proptest::prelude::*;
use proptest::sample::Index;
use prost::Message;

use crate::output::sentence;

/// Byte sequences that are critical for parsers.
fn pieces() -> Vec<&'static [u8]> {
    let pieces = b"nan|-inf|1e999|-1|0|1e-320|18446744073709551616|''|\"|[|]|=|\n|\r|;|,|\t|\0|\x1b[31m|\xff\xfe|\xe2\x88\x9e|{|../..|#|1_000_000";
    pieces.split(|byte| *byte == b'|').collect()
}

/// At one position, a part of this length is replaced by other bytes and by copies of itself.
#[derive(Debug, Clone)]
struct Change {
    at: Index,
    length: usize,
    by: Vec<u8>,
    times: usize,
}

fn change() -> impl Strategy<Value = Change> {
    let piece = || prop::sample::select(pieces()).prop_map(<[u8]>::to_vec);
    let byte = any::<u8>().prop_map(|byte| vec![byte]);
    let nothing = || Just(Vec::new());
    let kind = prop_oneof![
        // The rest is cut off.
        1 => (Just(usize::MAX), nothing(), Just(0)),
        2 => (1..40_usize, nothing(), Just(0)),
        2 => (1..200_usize, nothing(), 2..21_usize),
        3 => (Just(1), byte, Just(0)),
        3 => (Just(0), piece(), Just(0)),
        3 => (1..8_usize, piece(), Just(0)),
    ];
    (any::<Index>(), kind).prop_map(|(at, (length, by, times))| Change { at, length, by, times })
}

fn damaged(sound: &[u8], changes: &[Change]) -> Vec<u8> {
    let mut bytes = sound.to_vec();
    for Change { at, length, by, times } in changes {
        let from = at.index(bytes.len() + 1);
        let part: Vec<u8> = bytes[from..].iter().take(*length).copied().collect();
        let new = [by.clone(), part.repeat(*times)].concat();
        bytes.splice(from..from + part.len(), new);
    }
    bytes
}

/// Checks that an error message is not empty, is plain text, and does not quote the whole file.
fn is_plain(shown: &str) -> Result<(), TestCaseError> {
    prop_assert!(!shown.trim().is_empty(), "an error says something");
    prop_assert!(shown.len() < 4000, "too long: {}", &shown[..shown.floor_char_boundary(300)]);
    let control = shown.chars().find(|c| c.is_control() && !matches!(c, '\n' | '\t'));
    prop_assert!(control.is_none(), "{control:?} in {shown:?}");
    Ok(())
}

/// Writes a file with these bytes and reads it.
fn read<T>(bytes: &[u8], name: &str, read: impl Fn(&Path) -> anyhow::Result<T>) -> Result<(), TestCaseError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    match read(&path) {
        Ok(_) => Ok(()),
        Err(error) => is_plain(&sentence(&error)),
    }
}

/// A valid grid for requests and jobs.
fn small_grid() -> Grid {
    let axes = Axes {
        sigma_t_per_mm: vec![1.0, 2.0],
        albedo: vec![0.5, 0.9],
        g: vec![0.0, 0.4],
        thickness_mm: vec![0.5],
        sample_ior: vec![1.5],
    };
    let scene = Scene::paper().with_sensor(Sensor::new(10.0, 8, 0.0).unwrap());
    Grid::new(scene, axes, Walks::new(5000).unwrap(), 1, false).unwrap()
}

/// Access files of a farm with certificates: of the coordinator and of a worker.
fn access_files() -> &'static [String; 2] {
    static FILES: OnceLock<[String; 2]> = OnceLock::new();
    FILES.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let keys = folder.path().join("keys");
        crate::access_files::create(&keys, &["farm.example.org".to_owned()], 7700, true, 1_800_000_000)
            .unwrap();
        ["coordinator.toml", "worker.toml"].map(|name| std::fs::read_to_string(keys.join(name)).unwrap())
    })
}

/// Long words of a text, such as tokens and keys.
fn secrets(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c: char| !c.is_ascii_alphanumeric() && !b"+/".contains(&(c as u8)))
        .filter(|word| word.len() >= 40)
}

fn measurement() -> Measurement {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.csv");
    std::fs::write(&path, SHORT_CSV).unwrap();
    read_measurements(&path).unwrap().materials.remove(0)
}

const SHORT_CSV: &str = include_str!("damaged/short.csv");
const MIXTURES: &[u8] = include_bytes!("damaged/mixtures.toml");
const SESSION_JSON: &[u8] = include_bytes!("damaged/session.json");

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(cases()) })]

    /// Damage in files that users write causes an error and no panic.
    #[test]
    fn damaged_user_files_cause_no_panic(kind in 0..6_usize, changes in prop::collection::vec(change(), 1..6)) {
        let changed = |sound: &[u8]| damaged(sound, &changes);
        match kind {
            0 => read(&changed(include_bytes!("../../examples/grid.toml")), "grid.toml", read_grid)?,
            1 => read(&changed(include_bytes!("../../examples/scene.toml")), "scene.toml", |path| {
                farm_lab::grid_file::read_scene(path.to_str().unwrap())
            })?,
            2 => read(&changed(SHORT_CSV.as_bytes()), "m.csv", read_measurements)?,
            3 => read(&changed(MIXTURES), "chart.toml", read_mixtures)?,
            4 => read(&changed(SESSION_JSON), "session.json", set_up::Session::read)?,
            _ => read(&changed(include_bytes!("../../examples/session/session.toml")), "session.toml", CaptureSession::read)?,
        }
    }

    /// Damaged access files cause an error without a token or a key in it, and no panic.
    #[test]
    fn damaged_access_files_cause_no_panic(which in 0..2_usize, changes in prop::collection::vec(change(), 1..5)) {
        let sound = &access_files()[which];
        let bytes = damaged(sound.as_bytes(), &changes);
        let reader = |path: &Path| -> anyhow::Result<()> {
            use std::os::unix::fs::PermissionsExt;
            std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o600))?;
            let answer = match which {
                0 => CoordinatorAccess::read(path).map(drop),
                _ => ClientAccess::read(path).map(drop),
            };
            if let Err(error) = &answer {
                let shown = error.to_string();
                assert!(!secrets(sound).any(|secret| shown.contains(&secret[..20])), "{shown}");
            }
            Ok(answer?)
        };
        read(&bytes, "access.toml", reader)?;
    }

    /// Damaged messages of requests, including the values of the model, cause an error and no panic.
    #[test]
    fn damaged_messages_cause_no_panic(kind in 0..5_usize, changes in prop::collection::vec(change(), 1..5)) {
        let shown = match kind {
            0 => asked::<wire::Grid, Grid>(&wire::Grid::from(&small_grid()), &changes),
            1 => asked::<wire::Measurement, Measurement>(&(&measurement()).into(), &changes),
            2 => asked::<wire::FitOptions, FitOptions>(&(&FitOptions::default()).into(), &changes),
            3 => asked::<wire::MuRange, MuRange>(&MuRange::default().into(), &changes),
            _ => {
                let request = wire::DesignRequest { dictionary: "paper".to_owned(), ..Default::default() };
                asked::<wire::DesignRequest, DesignQuestion>(&request, &changes)
            }
        };
        if let Some(shown) = shown {
            is_plain(&shown)?;
        }
    }

    /// Damaged results of workers are refused, or contain only finite numbers.
    #[test]
    fn accepted_records_contain_only_numbers(
        changes in prop::collection::vec(change(), 1..5),
        refill in any::<bool>(),
    ) {
        let job = JobSpec::of(&small_grid(), 3);
        let length = PackedRecords::bytes_of(&job);
        let sound: Vec<u8> = std::iter::repeat_n(0.25_f32.to_le_bytes(), length / 4).flatten().collect();
        let mut bytes = damaged(&sound, &changes);
        if refill {
            bytes.resize(length, 0x7f);
        }
        match PackedRecords::new(&job, bytes.into()) {
            Ok(records) => for record in records.unpack() {
                for profile in &record.profiles {
                    prop_assert!(profile.radiance_factor.values().iter().all(|v| v.is_finite()));
                    prop_assert!(profile.radiance_factor.std_errors().iter().all(|v| *v >= 0.0));
                }
            },
            Err(error) => is_plain(&error.to_string())?,
        }
    }
}

/// `PROPTEST_CASES`, or 300.
fn cases() -> u32 {
    std::env::var("PROPTEST_CASES").map_or(300, |cases| cases.parse().expect("a number of cases"))
}

/// Converts a damaged message, and returns the reason if the model refuses it.
fn asked<M: Message + Default, T: TryFrom<M, Error = optics_model::Invalid>>(
    sound: &M,
    changes: &[Change],
) -> Option<String> {
    // Bytes that are no message are refused by the library.
    let message = M::decode(damaged(&sound.encode_to_vec(), changes).as_slice()).ok()?;
    T::try_from(message).err().map(|invalid| invalid.to_string())
}
