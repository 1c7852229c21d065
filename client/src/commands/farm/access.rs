use std::path::Path;

use anyhow::Result;
use serde::Serialize;

use crate::access_files::{self, members};
use crate::cli::{AccessAddArgs, AccessCommand, AccessCreateArgs, AccessRevokeArgs};
use crate::output::{Output, now_unix_s, utc};

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
            "{name} is let in as {role}, with {}\na coordinator that reads {} knows it within a second; one that was given \
             a copy needs it anew",
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
        format!("{name} is shut out of what reads {}", coordinator.display())
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
    text += &format!("  {}  for farm-coordinator --access, and for nobody else\n", data.coordinator);
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
