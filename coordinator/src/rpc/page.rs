//! Reads the page sizes and page tokens of list requests.

use optics_model::Invalid;

/// Number of items per page: the requested number, up to `most`; `default` if none is requested.
pub(super) fn page_size(asked: u32, default: u32, most: u32) -> usize {
    (if asked == 0 { default } else { asked.min(most) }) as usize
}

/// The number in a page token, at which the list continues; 0 for an empty token.
pub(super) fn page_token(token: &str) -> Result<i64, Invalid> {
    if token.is_empty() {
        return Ok(0);
    }
    let number = token.parse::<i64>().ok().filter(|n| *n >= 0);
    number.ok_or_else(|| {
        Invalid::new("page_token", format_args!("{token:?}"), "one from an earlier answer is needed")
    })
}
