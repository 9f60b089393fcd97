//! `data:` URIs: bytes that stand in the document itself, in base64.

use std::borrow::Cow;
use std::collections::HashMap;
use std::ops::Range;

use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};

use crate::block::checksum;

/// Padding at the end may be left out, as some writers do.
const ENGINE: GeneralPurpose = GeneralPurpose::new(
    &STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

/// The base64 text of a data URI; `None` for any other URI, and for data that is not in base64.
pub(super) fn text(uri: &str) -> Option<&str> {
    let data = strip_scheme(uri.as_bytes())?;
    let (head, text) = uri[uri.len() - data.len()..].split_once(',')?;
    is_base64(head.as_bytes()).then_some(text)
}

/// Whether a URI is a data URI.
pub(super) fn is_data(uri: &str) -> bool {
    strip_scheme(uri.as_bytes()).is_some()
}

fn strip_scheme(uri: &[u8]) -> Option<&[u8]> {
    let (scheme, rest) = uri.split_at_checked(5)?;
    scheme.eq_ignore_ascii_case(b"data:").then_some(rest)
}

fn is_base64(head: &[u8]) -> bool {
    const END: &[u8] = b";base64";
    head.len() >= END.len() && head[head.len() - END.len()..].eq_ignore_ascii_case(END)
}

/// Decodes base64; `None` if it is none.
pub(super) fn decode(text: &[u8]) -> Option<Vec<u8>> {
    ENGINE.decode(text).ok()
}

/// Decodes base64 as it stands inside a JSON string, where any character may be escaped (`\/` is common).
pub(crate) fn decode_json(text: &[u8]) -> Option<Vec<u8>> {
    decode(unescaped(text)?.as_ref())
}

fn unescaped(text: &[u8]) -> Option<Cow<'_, [u8]>> {
    if !text.contains(&b'\\') {
        return Some(Cow::Borrowed(text));
    }
    let quoted = [b"\"", text, b"\""].concat();
    let text: String = gltf::json::deserialize::from_slice(&quoted).ok()?;
    Some(Cow::Owned(text.into_bytes()))
}

/// Where the base64 texts of a document's data URIs are, by the checksum of the URI.
#[derive(Default)]
pub(super) struct DataPlaces(HashMap<u64, Range<u64>>);

impl DataPlaces {
    /// Finds them in JSON text that starts at `offset` of a file. The text must be sound: then quotes are at the ends of strings
    /// and nowhere else.
    pub fn find(json: &[u8], offset: u64) -> DataPlaces {
        let mut places = HashMap::new();
        let mut at = 0;
        while let Some(start) = memchr::memchr(b'"', &json[at..]).map(|found| at + found + 1) {
            let mut end = start;
            while let Some(found) = memchr::memchr2(b'"', b'\\', &json[end..]) {
                end += found;
                if json[end] == b'"' {
                    break;
                }
                // Whatever is escaped ends nothing.
                end = (end + 2).min(json.len());
            }
            let string = &json[start..end.min(json.len())];
            if strip_scheme(string).is_some()
                && let Some(comma) = memchr::memchr(b',', string)
                && is_base64(&string[..comma])
                && let Some(uri) = unescaped(string)
            {
                let first = offset + (start + comma + 1) as u64;
                places.insert(checksum(&uri), first..offset + end as u64);
            }
            at = (end + 1).min(json.len());
        }
        DataPlaces(places)
    }

    /// Where the text of a URI is in the file; `None` for one that has none. It takes time with the length of the URI.
    pub fn of(&self, uri: &str) -> Option<Range<u64>> {
        text(uri).and_then(|_| self.0.get(&checksum(uri.as_bytes())).cloned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uris_are_taken_apart() {
        assert_eq!(text("data:application/octet-stream;base64,AAEC"), Some("AAEC"));
        assert_eq!(text("DATA:;charset=x;BASE64,AA"), Some("AA"));
        assert_eq!(text("data:text/plain,AAEC"), None);
        assert_eq!(text("data:base64"), None);
        assert_eq!(text("a.png"), None);
        assert!(is_data("data:,") && !is_data("dat") && !is_data("datä:x"));
        assert_eq!(decode(b"AAEC").as_deref(), Some(&[0, 1, 2][..]));
        assert_eq!([decode(b"AA=="), decode(b"AA")], [Some(vec![0]), Some(vec![0])]);
        assert_eq!([decode(b"A"), decode(b"A%AA"), decode(b"AA==A")], [None, None, None]);
        assert_eq!(decode_json(br"\/\u002f8\u003d"), Some(vec![255, 255]));
        assert_eq!([decode_json(br"AA\"), decode_json(br"AA\q"), decode_json(b"\"\\\"")], [None, None, None]);
    }

    #[test]
    fn places_are_those_of_the_texts() {
        let json = br#"{"a\"data:;base64,no":["data:image\/png;base64,AA\/B","x","data:;base64,AAEC","data:,AAEC"]}"#;
        let places = DataPlaces::find(json, 1000);
        let shown = |uri: &str| {
            places.of(uri).map(|place| {
                std::str::from_utf8(&json[place.start as usize - 1000..place.end as usize - 1000]).unwrap()
            })
        };
        assert_eq!(shown("data:image/png;base64,AA/B"), Some(r"AA\/B"));
        assert_eq!(shown("data:;base64,AAEC"), Some("AAEC"));
        assert_eq!([shown("data:,AAEC"), shown("data:;base64,no")], [None, None]);
        // Text that is cut short does no harm.
        for length in 0..json.len() {
            DataPlaces::find(&json[..length], 0);
        }
    }
}
