//! Adds a member to an existing set of access files, or revokes a member's access.
//!
//! The authority's key is discarded, so a new member gets the certificates of its role's first file, if there are any:
//! they certify that their holder belongs to the farm. Its token has its own name and permissions.

use std::fs::{self, File, Permissions};
use std::io::{self, Read as _, Write as _};
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _, fchown};
use std::path::{Path, PathBuf};

use farm_link::{Role, is_token_name, sync_folder, token_hash};
use tempfile::Builder;
use toml_edit::{ArrayOfTables, DocumentMut, Item, Table, value};

use super::{CreateError, random_hex, write_secret};

/// The coordinator's file in a set's folder.
const COORDINATOR: &str = "coordinator.toml";
/// Changes of the set lock this file.
const LOCK: &str = ".farm-access.lock";
/// Largest file that a coordinator reads.
const LONGEST_BYTES: u64 = 1 << 20;

#[derive(Debug, thiserror::Error)]
pub enum MemberError {
    #[error("name {0:?} must be 1 to 64 letters, digits, '_', '.' or '-'")]
    Name(String),
    #[error("{} already has a member {name}: choose another name", .file.display())]
    Taken { file: PathBuf, name: String },
    #[error("{} has no member {name:?}; its members: {known}", .file.display())]
    Unknown { file: PathBuf, name: String, known: String },
    #[error("{name} is the last member of {}: add another first", .file.display())]
    Last { file: PathBuf, name: String },
    #[error("{} exists, and access files are never overwritten", .0.display())]
    Exists(PathBuf),
    #[error("{doing} {}: {source}", .path.display())]
    File { doing: &'static str, path: PathBuf, source: io::Error },
    #[error("{} is no access file of a set: {problem}", .path.display())]
    Content { path: PathBuf, problem: String },
    #[error(transparent)]
    Random(#[from] CreateError),
}

/// Adds a member: writes `FOLDER/NAME.toml` after the model of `FOLDER/ROLE.toml`, and an entry into the coordinator's
/// file, which a running coordinator reads again.
pub fn add(folder: &Path, role: Role, name: &str) -> Result<PathBuf, MemberError> {
    if !is_token_name(name) {
        return Err(MemberError::Name(name.to_owned()));
    }
    let coordinator_file = folder.join(COORDINATOR);
    let _alone = alone(folder)?;
    let mut coordinator = read(&coordinator_file)?;
    if entries(&mut coordinator, &coordinator_file)?.iter().any(|entry| name_of(entry) == name) {
        return Err(MemberError::Taken { file: coordinator_file, name: name.to_owned() });
    }
    let member_file = folder.join(format!("{name}.toml"));
    if fs::symlink_metadata(&member_file).is_ok() {
        return Err(MemberError::Exists(member_file));
    }
    let token = random_hex()?;
    let mut member = read(&folder.join(format!("{role}.toml")))?;
    member["token"] = value(token.as_str());
    let mut entry = Table::new();
    entry["role"] = value(role.as_str());
    entry["name"] = value(name);
    entry["blake3"] = value(token_hash(&token).to_string());
    entry.decor_mut().set_prefix("\n");
    entries(&mut coordinator, &coordinator_file)?.push(entry);
    write_secret(&member_file, &member.to_string()).map_err(failed("writing", &member_file))?;
    replace(&coordinator_file, &coordinator.to_string()).inspect_err(|_| {
        // Without the entry, no coordinator would accept the file.
        let _ = fs::remove_file(&member_file);
    })?;
    Ok(member_file)
}

/// Revokes the access of a member.
pub fn revoke(folder: &Path, name: &str) -> Result<(), MemberError> {
    let file = folder.join(COORDINATOR);
    let _alone = alone(folder)?;
    let mut coordinator = read(&file)?;
    let entries = entries(&mut coordinator, &file)?;
    if !entries.iter().any(|entry| name_of(entry) == name) {
        let known: Vec<&str> = entries.iter().map(name_of).collect();
        return Err(MemberError::Unknown { name: name.to_owned(), known: known.join(", "), file });
    }
    if entries.iter().all(|entry| name_of(entry) == name) {
        return Err(MemberError::Last { file, name: name.to_owned() });
    }
    entries.retain(|entry| name_of(entry) != name);
    replace(&file, &coordinator.to_string())
}

/// Roles and names of all members.
pub fn list(folder: &Path) -> Result<Vec<(String, String)>, MemberError> {
    let file = folder.join(COORDINATOR);
    let mut coordinator = read(&file)?;
    let text = |entry: &Table, key| entry.get(key).and_then(Item::as_str).unwrap_or_default().to_owned();
    Ok(entries(&mut coordinator, &file)?.iter().map(|e| (text(e, "role"), text(e, "name"))).collect())
}

/// Waits for an exclusive lock on the set, so that it does not change between reading and replacing.
fn alone(folder: &Path) -> Result<File, MemberError> {
    // No lock file is created in a folder without a set.
    fs::metadata(folder.join(COORDINATOR)).map_err(failed("reading", &folder.join(COORDINATOR)))?;
    let path = folder.join(LOCK);
    let lock = || {
        let file = File::options().create(true).truncate(false).write(true).mode(0o600).open(&path)?;
        file.lock()?;
        Ok(file)
    };
    lock().map_err(failed("locking", &path))
}

fn read(path: &Path) -> Result<DocumentMut, MemberError> {
    let mut text = String::new();
    let file = File::open(path).map_err(failed("reading", path))?;
    file.take(LONGEST_BYTES + 1).read_to_string(&mut text).map_err(failed("reading", path))?;
    if text.len() as u64 > LONGEST_BYTES {
        let problem = format!("it is longer than {LONGEST_BYTES} bytes");
        return Err(MemberError::Content { path: path.to_owned(), problem });
    }
    // The parser's message is omitted: it quotes the line, which may be a secret.
    let wrong =
        |_| MemberError::Content { path: path.to_owned(), problem: "it is not valid TOML".to_owned() };
    text.parse().map_err(wrong)
}

fn entries<'a>(file: &'a mut DocumentMut, path: &Path) -> Result<&'a mut ArrayOfTables, MemberError> {
    let tokens = file.get_mut("token").and_then(Item::as_array_of_tables_mut);
    tokens.ok_or_else(|| MemberError::Content {
        path: path.to_owned(),
        problem: "it has no [[token]]".to_owned(),
    })
}

fn name_of(entry: &Table) -> &str {
    entry.get("name").and_then(Item::as_str).unwrap_or_default()
}

fn failed(doing: &'static str, path: &Path) -> impl FnOnce(io::Error) -> MemberError {
    let path = path.to_owned();
    move |source| MemberError::File { doing, path, source }
}

/// Replaces a secret file atomically, with the same owner and permissions: a coordinator of another user must still be
/// able to read it.
fn replace(path: &Path, text: &str) -> Result<(), MemberError> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let write = || -> io::Result<()> {
        let before = fs::metadata(path)?;
        let mut draft = Builder::new().prefix(".farm-access-").tempfile_in(folder)?;
        draft.write_all(text.as_bytes())?;
        let own = draft.as_file().metadata()?;
        if (own.uid(), own.gid()) != (before.uid(), before.gid()) {
            fchown(draft.as_file(), Some(before.uid()), Some(before.gid()))?;
        }
        draft.as_file().set_permissions(Permissions::from_mode(before.mode() & 0o7777))?;
        draft.as_file().sync_all()?;
        draft.persist(path).map_err(|error| error.error)?;
        sync_folder(folder)
    };
    write().map_err(failed("writing", path))
}

#[cfg(test)]
mod tests {
    use farm_link::{ClientAccess, CoordinatorAccess};

    use super::*;
    use crate::access_files::{create, tests::mode};

    fn set(mutual: bool) -> (tempfile::TempDir, PathBuf) {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("access");
        create(&folder, &["farm.example.org".to_owned()], 7700, mutual, 1_800_000_000).unwrap();
        (place, folder)
    }

    fn token(path: &Path) -> String {
        read(path).unwrap()["token"].as_str().unwrap().to_owned()
    }

    /// A member is added or revoked, and the others stay.
    #[test]
    fn members_are_added_and_revoked_singly() {
        for mutual in [false, true] {
            let (_place, folder) = set(mutual);
            let coordinator = CoordinatorAccess::read(&folder.join(COORDINATOR)).unwrap();
            let before = fs::read_to_string(folder.join(COORDINATOR)).unwrap();
            let file = add(&folder, Role::Client, "alice").unwrap();
            assert_eq!(file, folder.join("alice.toml"));
            assert_eq!([mode(&file), mode(&folder.join(COORDINATOR))], [0o600, 0o600]);
            assert!(coordinator.refresh().unwrap());
            assert_eq!(coordinator.tokens().role_of(&token(&file)), Some((Role::Client, "alice")));
            let member = ClientAccess::read(&file).unwrap();
            assert_eq!((member.role(), member.server()), (Role::Client, "https://farm.example.org:7700"));
            assert_eq!(fs::read_to_string(&file).unwrap().contains("PRIVATE KEY"), mutual);
            assert_ne!(token(&file), token(&folder.join("client.toml")));

            revoke(&folder, "alice").unwrap();
            assert!(coordinator.refresh().unwrap());
            assert_eq!(coordinator.tokens().role_of(&token(&file)), None);
            assert_eq!(fs::read_to_string(folder.join(COORDINATOR)).unwrap(), before, "comments and all");
        }
    }

    /// Changes at the same time do not undo each other.
    #[test]
    fn concurrent_changes_are_all_kept() {
        let (_place, folder) = set(false);
        let names = |kind: &str| (0..8).map(|i| format!("{kind}{i}")).collect::<Vec<_>>();
        for name in names("old") {
            add(&folder, Role::Client, &name).unwrap();
        }
        std::thread::scope(|scope| {
            let folder = &folder;
            for (old, new) in names("old").into_iter().zip(names("new")) {
                scope.spawn(move || revoke(folder, &old).unwrap());
                scope.spawn(move || drop(add(folder, Role::Client, &new).unwrap()));
            }
        });
        let mut left: Vec<String> = list(&folder).unwrap().into_iter().map(|(_, name)| name).collect();
        left.sort();
        assert_eq!(
            left,
            [vec!["admin".to_owned(), "client".to_owned()], names("new"), vec!["worker".to_owned()]].concat()
        );
    }

    /// Mistakes change nothing, and their message states what is possible.
    #[test]
    fn mistakes_change_nothing() {
        let (_place, folder) = set(false);
        let refused = |name: &str| add(&folder, Role::Client, name).unwrap_err().to_string();
        let before = fs::read_to_string(folder.join(COORDINATOR)).unwrap();
        for name in ["", "a b", "../a", "ä", &"a".repeat(65)] {
            assert!(refused(name).contains("must be 1 to 64"), "{name}");
        }
        assert!(refused("worker").contains("already has a member worker"));
        assert!(refused("coordinator").contains("never overwritten"));
        let error = revoke(&folder, "bob").unwrap_err().to_string();
        assert!(error.contains("has no member \"bob\"; its members: worker, client, admin"), "{error}");
        assert_eq!(fs::read_to_string(folder.join(COORDINATOR)).unwrap(), before);
        revoke(&folder, "worker").unwrap();
        revoke(&folder, "client").unwrap();
        assert!(revoke(&folder, "admin").unwrap_err().to_string().contains("admin is the last member of"));
        let error = add(Path::new("/nowhere"), Role::Client, "a").unwrap_err().to_string();
        assert!(error.starts_with("reading /nowhere/coordinator.toml"), "{error}");
        fs::write(folder.join(COORDINATOR), "token = 'secret-secret\n").unwrap();
        let error = list(&folder).unwrap_err().to_string();
        assert!(error.contains("not valid TOML") && !error.contains("secret-secret"), "{error}");
    }
}
