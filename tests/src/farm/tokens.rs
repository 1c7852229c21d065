//! Farms whose workers have tokens of their own, so that each has a vote about results.

use super::Farm;
use crate::hand::HandWorker;
use crate::process::{Process, run};

impl Farm {
    /// Starts a coordinator with a token of its own for each of these workers, in `keys/NAME.toml`.
    ///
    /// # Panics
    /// If it does not answer, or a name is that of a file which is there for all.
    pub fn with_tokens(workers: &[&str], options: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a folder can be made");
        let data = folder.path().join("data");
        let mut farm = Self::new(folder, data, options);
        farm.create_access("keys", &[]);
        for name in workers {
            farm.let_in("worker", name);
        }
        farm.closed = true;
        farm.started()
    }

    /// Lets in one more, with an access file `keys/NAME.toml`.
    ///
    /// # Panics
    /// If there is one of that name.
    pub fn let_in(&self, role: &str, name: &str) {
        let ran = run(self.folder(), &["access", "add", role, name, "--folder", "keys"]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
    }

    /// A worker by hand, with the token of this name.
    pub async fn hand_of(&self, token: &str, label: &str) -> Result<HandWorker, tonic::Status> {
        HandWorker::register(self.link_with(&format!("keys/{token}.toml")), label).await
    }

    /// A worker with one thread and the token of this name, which is what it is called, too.
    pub fn worker_of(&self, token: &str) -> Process {
        self.worker_with(&format!("keys/{token}.toml"), token, &[])
    }
}
