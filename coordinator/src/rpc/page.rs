//! The pages of lists: their sizes and tokens, and what fits into one.

use optics_model::Invalid;
use prost::Message;

/// Most bytes of a page of several items.
const PAGE_BYTES: usize = 1 << 20;

/// The items that fit into a page, at most `most`, and the token of the next page: the key of the last item, or nothing if
/// no others follow.
pub(super) fn page<K: ToString, T: Message>(
    items: impl IntoIterator<Item = (K, T)>,
    most: usize,
) -> (Vec<T>, String) {
    let (mut page, mut bytes, mut last) = (Vec::new(), 0, String::new());
    for (key, item) in items {
        bytes += item.encoded_len();
        if page.len() == most || (bytes > PAGE_BYTES && !page.is_empty()) {
            return (page, last);
        }
        page.push(item);
        last = key.to_string();
    }
    (page, String::new())
}

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

#[cfg(test)]
mod tests {
    use farm_proto::wire::Event;

    use super::*;

    /// A page has as many items as were asked for, or as fit, and at least one.
    #[test]
    fn pages_are_bounded_by_items_and_bytes() {
        let items = |bytes: [usize; 4]| {
            let event = |bytes| Event { message: "x".repeat(bytes), ..Default::default() };
            bytes.into_iter().enumerate().map(move |(i, bytes)| (i, event(bytes)))
        };
        for (bytes, most, expected) in [
            ([10; 4], 4, (4, "")),
            ([10; 4], 3, (3, "2")),
            ([400_000; 4], 4, (2, "1")),
            ([5_000_000; 4], 4, (1, "0")),
        ] {
            let (page, next) = page(items(bytes), most);
            assert_eq!((page.len(), next.as_str()), expected);
        }
    }
}
