//! Finds out where the log of this process can be read after it has ended. The coordinator shows that place with each
//! failed job.

use std::env;
use std::ffi::OsString;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use crate::machine;

/// The properties of the environment that determine where standard error goes.
struct Surroundings<'a> {
    variable: &'a dyn Fn(&str) -> Option<OsString>,
    /// The device and inode of standard error, as `DEVICE:INODE`.
    stderr_id: Option<String>,
    /// The regular file to which standard error is redirected.
    stderr_file: Option<&'a Path>,
    in_docker: bool,
    host: &'a str,
}

/// The place at which this process's standard error can be read, as a path with its host or as a command: a regular
/// file, the journal, a container's log. Empty if unknown, as for a terminal or a pipe.
pub fn log_place() -> String {
    let stderr = fs::read_link("/proc/self/fd/2").ok();
    let about = stderr.as_deref().and_then(|_| fs::metadata("/proc/self/fd/2").ok());
    let is_file = about.as_ref().is_some_and(fs::Metadata::is_file);
    place(&Surroundings {
        variable: &|name| env::var_os(name),
        stderr_id: about.map(|about| format!("{}:{}", about.dev(), about.ino())),
        stderr_file: stderr.as_deref().filter(|path| is_file && path.is_absolute()),
        in_docker: Path::new("/.dockerenv").exists(),
        host: &machine::name(),
    })
}

fn place(around: &Surroundings) -> String {
    let text = |name| (around.variable)(name).and_then(|value| value.into_string().ok());
    let host = around.host;
    if let Some(file) = around.stderr_file {
        return format!("{host}:{}", file.display());
    }
    // According to systemd.exec(5), only if standard error is still that stream.
    let in_journal = text("JOURNAL_STREAM").is_some_and(|stream| Some(stream) == around.stderr_id);
    if let (true, Some(invocation)) = (in_journal, text("INVOCATION_ID")) {
        return format!("`journalctl _SYSTEMD_INVOCATION_ID={invocation}` on {host}");
    }
    // Kubernetes and Docker name a container's host after the pod or the container.
    if (around.variable)("KUBERNETES_SERVICE_HOST").is_some() {
        return format!("`kubectl logs {host}`");
    }
    if around.in_docker { format!("`docker logs {host}`") } else { String::new() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn placed(variables: &[(&str, &str)], file: Option<&str>, in_docker: bool) -> String {
        let variable = |name: &str| {
            variables.iter().find(|(variable, _)| *variable == name).map(|(_, value)| OsString::from(value))
        };
        place(&Surroundings {
            variable: &variable,
            stderr_id: Some("8:17".to_owned()),
            stderr_file: file.map(Path::new),
            in_docker,
            host: "node7",
        })
    }

    /// The log is reported at the place where the launcher of the worker keeps it.
    #[test]
    fn log_place_follows_the_launcher() {
        let unit = [("JOURNAL_STREAM", "8:17"), ("INVOCATION_ID", "c0ffee")];
        let pod = [("KUBERNETES_SERVICE_HOST", "10.0.0.1")];
        for (variables, file, in_docker, expected) in [
            (&unit[..], None, false, "`journalctl _SYSTEMD_INVOCATION_ID=c0ffee` on node7"),
            (&unit, Some("/var/log/slurm-17.out"), false, "node7:/var/log/slurm-17.out"),
            (&[("JOURNAL_STREAM", "8:18"), unit[1]], None, false, ""),
            (&pod, None, false, "`kubectl logs node7`"),
            (&[], None, true, "`docker logs node7`"),
            (&[], None, false, ""),
        ] {
            assert_eq!(placed(variables, file, in_docker), expected);
        }
    }
}
