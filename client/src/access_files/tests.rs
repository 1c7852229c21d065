use farm_link::{ClientAccess, CoordinatorAccess};

use super::*;

const NOW_UNIX_S: i64 = 1_800_000_000;

fn hosts(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

pub(super) fn mode(path: &Path) -> u32 {
    fs::metadata(path).unwrap().permissions().mode() & 0o7777
}

/// The access files are private, complete and can be read back.
#[test]
fn access_files_are_private_and_readable() {
    for mutual in [false, true] {
        let place = tempfile::tempdir().unwrap();
        let dir = place.path().join("access");
        let created =
            create(&dir, &hosts(&["farm.example.org", "10.1.2.3"]), 7700, mutual, NOW_UNIX_S).unwrap();
        assert_eq!(created.server, "https://farm.example.org:7700");
        assert_eq!(created.valid_until_unix_s, NOW_UNIX_S + 3653 * 86_400);
        assert_eq!(mode(&dir), 0o700);
        assert_eq!(fs::read_dir(&dir).unwrap().count(), 4);
        assert_eq!(mode(&created.coordinator), 0o600);
        let coordinator = CoordinatorAccess::read(&created.coordinator).unwrap();
        assert_eq!(coordinator.is_mutual(), mutual);
        for (role, path) in created.members {
            assert_eq!(mode(&path), 0o600);
            let member = ClientAccess::read(&path).unwrap();
            assert_eq!((member.role(), member.server()), (role, created.server.as_str()));
            let text = fs::read_to_string(&path).unwrap();
            let token = text.lines().find_map(|l| l.strip_prefix("token = \"")?.strip_suffix('"')).unwrap();
            assert_eq!(token.len(), 64);
            assert_eq!(coordinator.tokens().role_of(token), Some((role, role.as_str())));
            assert!(!fs::read_to_string(&created.coordinator).unwrap().contains(token));
            assert_eq!(text.contains("PRIVATE KEY"), mutual);
        }
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 1, "no draft is left");
    }
}

/// Two sets of access files share no certificate, key, token or hash.
#[test]
fn access_sets_share_no_secret() {
    let place = tempfile::tempdir().unwrap();
    let texts = ["one", "two"].map(|name| {
        let created = create(&place.path().join(name), &hosts(&["a"]), 7700, true, NOW_UNIX_S).unwrap();
        let members = created.members.into_iter().map(|(_, path)| path);
        members.chain([created.coordinator]).map(|p| fs::read_to_string(p).unwrap()).collect::<String>()
    });
    // Certificates, keys, tokens and their hashes.
    let secrets = |text: &str| {
        let blocks = text.split("'''").skip(1).step_by(2);
        let words = text.split('"').filter(|word| word.len() == 64);
        blocks.chain(words).map(str::to_owned).collect::<BTreeSet<_>>()
    };
    let [one, two] = texts.map(|text| secrets(&text));
    // The authority, four certificates with their keys, three tokens with their hashes.
    assert_eq!([one.len(), two.len()], [15, 15]);
    assert_eq!(one.intersection(&two).count(), 0);
}

/// A folder, file or link that exists is not touched.
#[test]
fn existing_files_are_not_touched() {
    let place = tempfile::tempdir().unwrap();
    let (folder, file, link) =
        (place.path().join("folder"), place.path().join("file"), place.path().join("link"));
    fs::create_dir(&folder).unwrap();
    fs::write(&file, "mine").unwrap();
    std::os::unix::fs::symlink("/nowhere", &link).unwrap();
    for dir in [&folder, &file, &link] {
        let error = create(dir, &hosts(&["a"]), 7700, false, NOW_UNIX_S).unwrap_err();
        assert!(matches!(&error, CreateError::Exists(path) if path == dir), "{error}");
    }
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
    assert_eq!(fs::read_to_string(&file).unwrap(), "mine");
    assert_eq!(fs::read_dir(place.path()).unwrap().count(), 3);
}

/// A failed creation leaves no draft and replaces no folder.
#[test]
fn failed_creation_leaves_nothing() {
    let place = tempfile::tempdir().unwrap();
    let dir = place.path().join("missing").join("access");
    let error = create(&dir, &hosts(&["a"]), 7700, false, NOW_UNIX_S).unwrap_err();
    assert!(error.to_string().starts_with("making a folder in"), "{error}");
    // A folder that is created in the meantime is not replaced, and the draft is removed.
    let taken = place.path().join("taken");
    fs::create_dir(&taken).unwrap();
    fs::write(taken.join("file"), "theirs").unwrap();
    assert!(write_folder(&taken, &[("a.toml".to_owned(), String::new())]).is_err());
    assert_eq!(fs::read_dir(place.path()).unwrap().count(), 1);
    assert_eq!(fs::read_dir(&taken).unwrap().count(), 1);
}

/// Hosts are names or addresses, and one is needed.
#[test]
fn hosts_are_names_or_addresses() {
    for host in ["farm", "farm.example.org", "node_1.cluster", "10.0.0.1", "::1", "2001:db8::2"] {
        assert!(is_host(host), "{host}");
    }
    let wrong = "|farm:7700|https://farm|a b|*.example.org|10.0.0|a..b|-a|[::1]|ä";
    for host in wrong.split('|').chain([&*"a".repeat(64)]) {
        assert!(!is_host(host), "{host}");
        let error = certificate_names(&hosts(&["good", host])).unwrap_err();
        assert!(error.to_string().starts_with(&format!("host {host:?} must be")), "{error}");
    }
    let nowhere = Path::new("/nowhere/access");
    assert!(matches!(create(nowhere, &[], 7700, false, NOW_UNIX_S), Err(CreateError::NoHost)));
    assert!(matches!(create(nowhere, &hosts(&["a"]), 0, false, NOW_UNIX_S), Err(CreateError::Port)));
    assert!(matches!(create(nowhere, &hosts(&["a"]), 1, false, i64::MAX), Err(CreateError::Time(i64::MAX))));
}

/// The coordinator's own machine is always among the names of the certificate.
#[test]
fn local_machine_is_always_named() {
    let names = certificate_names(&hosts(&["farm", "LOCALHOST", "farm"])).unwrap();
    assert_eq!(names, ["farm", "LOCALHOST", "127.0.0.1", "::1"]);
    assert_eq!(server_url(&hosts(&["2001:db8::2"]), 7700).unwrap(), "https://[2001:db8::2]:7700");
}
