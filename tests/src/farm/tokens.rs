//! Farms whose workers have tokens of their own, so that each has a vote about results.

use super::Farm;
use crate::hand::HandWorker;
use crate::process::Process;

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
            assert!(!farm.path(&format!("keys/{name}.toml")).exists(), "{name}.toml is there already");
            farm.add_token(name);
        }
        farm.closed = true;
        farm.started()
    }

    fn add_token(&self, name: &str) {
        let token = farm_link::token_hash(name).to_string();
        let hash = farm_link::token_hash(&token);
        let coordinator = self.path("keys/coordinator.toml");
        let entry = format!("\n[[token]]\nrole = \"worker\"\nname = \"{name}\"\nblake3 = \"{hash}\"\n");
        let before = std::fs::read_to_string(&coordinator).unwrap();
        std::fs::write(&coordinator, before + &entry).unwrap();
        let (shared, own) = (self.path("keys/worker.toml"), self.path(&format!("keys/{name}.toml")));
        // With its permissions.
        std::fs::copy(&shared, &own).unwrap();
        let text = std::fs::read_to_string(&shared).unwrap();
        let lines = text.lines().map(|line| match line.split_once(" = ") {
            Some(("token", _)) => format!("token = \"{token}\"\n"),
            _ => format!("{line}\n"),
        });
        std::fs::write(&own, lines.collect::<String>()).unwrap();
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
