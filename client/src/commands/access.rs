use anyhow::Result;
use serde::Serialize;

use crate::access_files;
use crate::cli::{AccessCommand, AccessCreateArgs};
use crate::output::{Output, now_unix_s, utc};

#[derive(Debug, Serialize)]
struct AccessJson {
    coordinator: String,
    members: Vec<MemberJson>,
    server: String,
    valid_until_unix_s: i64,
}

#[derive(Debug, Serialize)]
struct MemberJson {
    role: &'static str,
    file: String,
}

pub(crate) fn run(command: AccessCommand, output: &Output) -> Result<()> {
    match command {
        AccessCommand::Create(args) => create(&args, output),
    }
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
