//! Runs farms whose workers have separate tokens, so that each can be fenced off by itself.

use super::Farm;
use crate::process::{Process, run};
use crate::test_worker::TestWorker;

impl Farm {
    /// Starts a coordinator with a separate token for each of these workers, in `keys/NAME.toml`.
    ///
    /// # Panics
    /// If it does not answer, or a name is that of another access file.
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

    /// Adds an access file `keys/NAME.toml`.
    ///
    /// # Panics
    /// If that file exists.
    pub fn let_in(&self, role: &str, name: &str) {
        let ran = run(self.folder(), &["access", "add", role, name, "--folder", "keys"]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
    }

    /// A worker that a test controls, with the token of this name.
    pub async fn test_worker_with(&self, token: &str, label: &str) -> Result<TestWorker, tonic::Status> {
        TestWorker::register(self.link_with(&format!("keys/{token}.toml")), label).await
    }

    /// A worker with one thread and the token of this name, which is also its label.
    pub fn worker_of(&self, token: &str) -> Process {
        self.worker_with(&format!("keys/{token}.toml"), token, &[])
    }
}
