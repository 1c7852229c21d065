//! Lists in pages.

use optics_model::Invalid;

/// Items of a page: what is asked for, up to `most`; `default` if nothing is.
pub(super) fn page_size(asked: u32, default: u32, most: u32) -> usize {
    (if asked == 0 { default } else { asked.min(most) }) as usize
}

/// The number that a page token holds: that of the last item before the page.
pub(super) fn page_token(token: &str) -> Result<i64, Invalid> {
    if token.is_empty() {
        return Ok(0);
    }
    let number = token.parse::<i64>().ok().filter(|n| *n >= 0);
    number.ok_or_else(|| {
        Invalid::new("page_token", format_args!("{token:?}"), "one from an earlier answer is needed")
    })
}
