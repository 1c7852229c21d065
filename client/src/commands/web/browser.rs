//! Opens the page in the user's browser.

use std::io::Write as _;

use tempfile::NamedTempFile;

/// Opens an address that contains a secret. Other users see the arguments of a process, so the browser is given a file
/// that only this user can read, and that redirects to the address. The file must be kept until the browser has read it.
/// `None` if there is no browser here.
pub(super) fn open(url: &str) -> Option<NamedTempFile> {
    if cfg!(target_os = "linux")
        && !["DISPLAY", "WAYLAND_DISPLAY"].iter().any(|v| std::env::var_os(v).is_some())
    {
        return None;
    }
    let mut file = tempfile::Builder::new().prefix("farmctl-web-").suffix(".html").tempfile().ok()?;
    file.write_all(page(url).as_bytes()).ok()?;
    file.flush().ok()?;
    // Without a browser, the printed address is enough.
    open::that_detached(file.path()).ok()?;
    Some(file)
}

fn page(url: &str) -> String {
    format!(
        "<!doctype html>\n<meta charset=\"utf-8\">\n<meta http-equiv=\"refresh\" content=\"0; url={url}\">\n\
         <title>farmctl web</title>\n<p><a href=\"{url}\">the page</a>\n"
    )
}
