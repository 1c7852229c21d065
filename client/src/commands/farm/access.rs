//! Implements `farmctl access`: creates a set of access files, and adds, revokes and lists members.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::{Args, Subcommand};
use farm_link::Role;
use serde::Serialize;

use crate::access_files::{self, members};
use crate::output::{Output, now_unix_s, utc};

#[derive(Debug, Subcommand)]
pub(crate) enum AccessCommand {
    /// Create access files for the coordinator and for each role: worker, client and admin.
    Create(AccessCreateArgs),
    /// Add a member with a token and an access file of its own; a running coordinator accepts it within a second.
    #[command(after_help = "\
Examples:
  farmctl access add worker node7          writes access/node7.toml, for that machine
  farmctl access add client alice --folder /etc/farm")]
    Add(AccessAddArgs),
    /// Revoke a member's access by name; a running coordinator follows within a second.
    #[command(after_help = "\
Examples:
  farmctl access revoke alice
  farmctl access revoke node7 --folder /etc/farm")]
    Revoke(AccessRevokeArgs),
    /// List the members with their roles.
    #[command(after_help = "\
Example:
  farmctl access list --folder /etc/farm")]
    List(AccessFolderArgs),
}

#[derive(Debug, Args)]
pub(crate) struct AccessFolderArgs {
    /// Folder with the access files.
    #[arg(long, value_name = "DIR", default_value = "access")]
    folder: PathBuf,
}

#[derive(Debug, Args)]
pub(crate) struct AccessAddArgs {
    /// worker, client or admin.
    #[arg(value_parser = role)]
    role: Role,
    /// Name of the holder: in logs and events, of the file, and of the owner of dictionaries.
    name: String,
    #[command(flatten)]
    set: AccessFolderArgs,
}

#[derive(Debug, Args)]
pub(crate) struct AccessRevokeArgs {
    /// As `farmctl access list` shows it.
    name: String,
    #[command(flatten)]
    set: AccessFolderArgs,
}

fn role(text: &str) -> Result<Role, String> {
    Role::ALL
        .into_iter()
        .find(|r| r.as_str() == text)
        .ok_or_else(|| "worker, client or admin is needed".to_owned())
}

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl access create access --host farm.example.org
  farmctl access create access --host farm.example.org --host 10.0.0.5 --mutual")]
pub(crate) struct AccessCreateArgs {
    /// Folder to create; it must not exist yet.
    folder: PathBuf,
    /// Host name or address at which others reach the coordinator; may be given several times, and the first goes into
    /// the roles' access files.
    #[arg(long, value_name = "NAME", required = true)]
    host: Vec<String>,
    /// Port of the coordinator.
    #[arg(long, value_name = "N", default_value_t = 7700)]
    port: u16,
    /// Also give each role a certificate of its own, and require one of every client (mutual TLS).
    #[arg(long)]
    mutual: bool,
}

#[derive(Debug, Serialize)]
struct AccessJson {
    coordinator: String,
    members: Vec<MemberJson>,
    server: String,
    valid_until_unix_s: i64,
}

#[derive(Debug, Serialize)]
struct RevokedJson {
    name: String,
}

#[derive(Debug, Serialize)]
struct LetInListJson {
    members: Vec<LetInJson>,
}

#[derive(Debug, Serialize)]
struct LetInJson {
    role: String,
    name: String,
}

#[derive(Debug, Serialize)]
struct MemberJson {
    role: &'static str,
    file: String,
}

pub(crate) fn run(command: AccessCommand, output: &Output) -> Result<()> {
    match command {
        AccessCommand::Create(args) => create(&args, output),
        AccessCommand::Add(args) => add(&args, output),
        AccessCommand::Revoke(args) => revoke(&args, output),
        AccessCommand::List(args) => list(&args.folder, output),
    }
}

fn add(args: &AccessAddArgs, output: &Output) -> Result<()> {
    let (folder, role, name) = (&args.set.folder, args.role, &args.name);
    let file = members::add(folder, role, name)?;
    let data = MemberJson { role: role.as_str(), file: file.display().to_string() };
    output.print("access_added", &data, || {
        let coordinator = folder.join("coordinator.toml");
        format!(
            "{name} has access as {role}, with {}\na coordinator that reads {} accepts it within a second; a copy of that \
             file must be replaced",
            file.display(),
            coordinator.display()
        )
    })
}

fn revoke(args: &AccessRevokeArgs, output: &Output) -> Result<()> {
    let (folder, name) = (&args.set.folder, &args.name);
    members::revoke(folder, name)?;
    output.print("access_revoked", &RevokedJson { name: name.clone() }, || {
        let coordinator = folder.join("coordinator.toml");
        format!("{name} no longer has access to a coordinator that reads {}", coordinator.display())
    })
}

fn list(folder: &Path, output: &Output) -> Result<()> {
    let let_in = members::list(folder)?.into_iter().map(|(role, name)| LetInJson { role, name });
    let data = LetInListJson { members: let_in.collect() };
    output.print("access_list", &data, || {
        let rows = data.members.iter().map(|m| format!("{:<8}{}", m.role, m.name));
        rows.collect::<Vec<_>>().join("\n")
    })
}

fn create(args: &AccessCreateArgs, output: &Output) -> Result<()> {
    let created = access_files::create(&args.folder, &args.host, args.port, args.mutual, now_unix_s())?;
    let data = AccessJson {
        coordinator: created.coordinator.display().to_string(),
        members: created
            .members
            .iter()
            .map(|(role, file)| MemberJson { role: role.as_str(), file: file.display().to_string() })
            .collect(),
        server: created.server.clone(),
        valid_until_unix_s: created.valid_until_unix_s,
    };
    output.print("access", &data, || text(&data))
}

fn text(data: &AccessJson) -> String {
    let mut text = format!("access files for {}:\n", data.server);
    text += &format!("  {}  for farm-coordinator --access; keep it there only\n", data.coordinator);
    for MemberJson { role, file } in &data.members {
        let whom = match *role {
            "worker" => "for farm-worker --access",
            "client" => "for people: farmctl --access",
            _ => "for those who look after the farm: farmctl --access",
        };
        text += &format!("  {file}  {whom}\n");
    }
    let until = utc(u64::try_from(data.valid_until_unix_s).unwrap_or(0) * 1000);
    text + &format!("the certificates hold until {until}")
}
