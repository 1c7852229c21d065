//! Controls a headless Chromium through its driver, with the actions of a user.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use serde_json::{Value, json};
use thirtyfour::prelude::*;
use thirtyfour::{ChromeCapabilities, ChromiumLikeCapabilities};
use tokio::time::{Instant, sleep};

use farm_tests::process::{Process, SOON, free_port};

/// Pause between two checks of the page.
const LOOK: Duration = Duration::from_millis(30);
/// A host name that resolves to this machine, as after DNS rebinding by a hostile site.
pub const OTHER_NAME: &str = "other.example";

/// A browser with a separate profile.
#[derive(Debug)]
pub struct Browser {
    pub driver: WebDriver,
    folder: tempfile::TempDir,
    _process: Process,
}

/// Whether the browser and its driver are installed.
pub fn is_there() -> bool {
    let there = ["chromium", "chromedriver"]
        .iter()
        .all(|program| Command::new(program).arg("--version").output().is_ok_and(|ran| ran.status.success()));
    if !there {
        eprintln!("SKIPPED: chromium and chromedriver are not installed (Debian: chromium, chromium-driver)");
    }
    there
}

impl Browser {
    /// Starts a browser.
    ///
    /// # Panics
    /// If it does not start.
    pub async fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("downloads")).unwrap();
        let port = free_port();
        let mut command = Command::new("chromedriver");
        command.arg(format!("--port={port}")).env("HOME", folder.path());
        let process = Process::spawn("chromedriver", &mut command, &folder.path().join("chromedriver.log"));
        let deadline = Instant::now() + SOON;
        let driver = loop {
            match WebDriver::new(format!("http://127.0.0.1:{port}"), capabilities(folder.path())).await {
                Ok(driver) => break driver,
                Err(error) if Instant::now() > deadline => panic!("no browser: {error}"),
                Err(_) => sleep(LOOK).await,
            }
        };
        let browser = Self { driver, folder, _process: process };
        browser.size(1280, 900).await;
        browser
    }

    /// Shuts the browser down; otherwise it is killed when dropped.
    pub async fn end(self) {
        self.driver.clone().quit().await.unwrap();
    }

    /// Opens an address.
    pub async fn open(&self, url: &str) {
        self.driver.goto(url).await.unwrap();
    }

    /// The value that a script returns; it is a function's body, with `arguments`.
    pub async fn script(&self, script: &str, arguments: Vec<Value>) -> Value {
        let returned = self.driver.execute(script, arguments).await;
        returned.unwrap_or_else(|e| panic!("{script}: {e}")).json().clone()
    }

    /// Sends a command of the DevTools protocol.
    pub async fn order(&self, method: &str, parameters: Value) -> Value {
        self.driver.cdp().send_raw(method, parameters).await.unwrap()
    }

    /// Waits until `look` finds something on the page.
    ///
    /// # Panics
    /// If it finds nothing in time; the message contains the page.
    pub async fn wait<T>(
        &self,
        what: &str,
        limit: Duration,
        mut look: impl AsyncFnMut(&Self) -> Option<T>,
    ) -> T {
        let deadline = Instant::now() + limit;
        loop {
            if let Some(found) = look(self).await {
                return found;
            }
            if Instant::now() > deadline {
                let shown = self.shown().await;
                panic!("timeout of {limit:?}: {what}\n--- the page shows:\n{shown}");
            }
            sleep(LOOK).await;
        }
    }

    /// The visible text.
    pub async fn shown(&self) -> String {
        self.script("return document.body?.innerText ?? ''", vec![])
            .await
            .as_str()
            .unwrap_or_default()
            .to_owned()
    }

    /// Waits until the page shows this text.
    pub async fn shows(&self, text: &str) {
        self.shows_within(text, SOON).await;
    }

    pub async fn shows_within(&self, text: &str, limit: Duration) {
        self.wait(text, limit, async |page| page.shown().await.contains(text).then_some(())).await;
    }

    /// Waits for a visible element.
    pub async fn element(&self, by: By) -> WebElement {
        self.wait(&format!("{by:?}"), SOON, async |page| {
            let found = page.driver.find(by.clone()).await.ok()?;
            found.is_displayed().await.unwrap_or(false).then_some(found)
        })
        .await
    }

    pub async fn css(&self, selector: &str) -> WebElement {
        self.element(By::Css(selector)).await
    }

    /// Presses a button once it is enabled.
    pub async fn press(&self, name: &str) {
        let by = By::XPath(format!("//button[normalize-space()=\"{name}\"]"));
        self.wait(&format!("a button {name:?}"), SOON, async |page| {
            let button = page.driver.find(by.clone()).await.ok()?;
            if !button.is_enabled().await.unwrap_or(false) {
                return None;
            }
            button.click().await.ok()
        })
        .await;
    }

    /// Chooses a file in the visible file field that the selector finds.
    pub async fn choose_file(&self, selector: &str, file: &Path) {
        self.css(selector).await.send_keys(file.to_str().unwrap()).await.unwrap();
    }

    /// Selects an option of the first choice that the selector finds.
    pub async fn pick(&self, selector: &str, value: &str) {
        self.css(selector).await;
        let script = "const [selector, value] = arguments; const choice = document.querySelector(selector); \
                      choice.value = value; choice.dispatchEvent(new Event('change', { bubbles: true })); \
                      return choice.value";
        let picked = self.script(script, vec![json!(selector), json!(value)]).await;
        assert_eq!(picked, value, "{selector}");
    }

    /// Sets the size of the visible part of the page, in its pixels.
    pub async fn size(&self, width: u32, height: u32) {
        let size = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600 });
        self.order("Emulation.setDeviceMetricsOverride", size).await;
    }

    /// Sets whether the user prefers dark pages.
    pub async fn dark(&self, dark: bool) {
        let value = if dark { "dark" } else { "light" };
        let preference = json!({ "features": [{ "name": "prefers-color-scheme", "value": value }] });
        self.order("Emulation.setEmulatedMedia", preference).await;
    }

    /// Errors on the browser's console since the last call.
    pub async fn complaints(&self) -> Vec<String> {
        let log = self.driver.browser_log().await.unwrap();
        let severe =
            log.into_iter().filter(|entry| format!("{:?}", entry.level).eq_ignore_ascii_case("severe"));
        severe.map(|entry| entry.message).collect()
    }

    /// Waits for a file that the page saves.
    pub async fn saved(&self, name: &str) -> PathBuf {
        let file = self.folder.path().join("downloads").join(name);
        // Chromium reserves the name by an empty file, over which it moves the finished one.
        let is_whole = || file.metadata().is_ok_and(|data| data.len() > 0);
        self.wait(&format!("{name} is saved"), SOON, async |_| is_whole().then_some(())).await;
        file
    }
}

fn capabilities(folder: &Path) -> ChromeCapabilities {
    let mut capabilities = DesiredCapabilities::chrome();
    let profile = format!("--user-data-dir={}", folder.join("profile").display());
    let names = format!("--host-resolver-rules=MAP {OTHER_NAME} 127.0.0.1");
    // In containers the user is root, for which the browser's sandbox does not start.
    for option in
        ["--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu", &profile, &names]
    {
        capabilities.add_arg(option).unwrap();
    }
    let downloads = folder.join("downloads").display().to_string();
    let preferences =
        json!({ "download.default_directory": downloads, "download.prompt_for_download": false });
    capabilities.add_experimental_option("prefs", preferences).unwrap();
    capabilities.set("goog:loggingPrefs", json!({ "browser": "ALL" })).unwrap();
    capabilities
}
