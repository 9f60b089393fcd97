//! Numbers against the standard library's parser, which rounds exactly.

use proptest::prelude::*;

use crate::import::number::{digits, parse, scan};

/// `scan` on a padded copy.
fn scanned(text: &str) -> Option<(f64, bool, usize)> {
    let mut bytes = text.as_bytes().to_vec();
    bytes.extend_from_slice(&[b'\n'; 32]);
    scan(&bytes, 0)
}

#[track_caller]
fn agrees(text: &str) {
    let expected: f64 = text.parse().unwrap();
    let (value, _, length) = scanned(text).unwrap_or_else(|| panic!("{text} is not read"));
    assert_eq!(value.to_bits(), expected.to_bits(), "{text}");
    assert_eq!(length, text.len(), "{text}");
    assert_eq!(parse(text.as_bytes()).map(f64::to_bits), Some(expected.to_bits()), "{text}");
}

#[test]
fn every_form() {
    for text in [
        "0",
        "-0",
        "1.",
        ".5",
        "-.5",
        "+1",
        "+.25",
        "1e-5",
        "1E5",
        "1e+5",
        "-1.5e300",
        "1e400",
        "0.1",
        "12345678",
        "123456789",
        "1234567890123456",
        "12345678901234567",
        "0.12345678",
        "0.1234567890123456",
        "0.12345678901234567",
        "9007199254740993",
        "9007199254740993.0",
        "4.9e-324",
        "00000000000000000001.5",
        "123456.123456789012",
        "1.7976931348623157e308",
        "0.30000000000000004",
        "inf",
        "-inf",
        "infinity",
    ] {
        agrees(text);
    }
    for text in ["nan", "NaN", "-nan", "1.#IND", "-1.#QNAN0"] {
        assert!(parse(text.as_bytes()).unwrap().is_nan(), "{text}");
    }
    assert_eq!(parse(b"1.#INF"), Some(f64::INFINITY));
    assert_eq!(parse(b"-1.#INF00"), Some(f64::NEG_INFINITY));
    for text in ["", "-", "+", ".", "abc", "1x", "1.2.3", "--1", "+-1", "1,5", "1e", "0x10", "1_0"] {
        assert_eq!(parse(text.as_bytes()), None, "{text}");
        assert_eq!(scanned(text), None, "{text}");
    }
}

#[test]
fn digits_stop_at_any_other_byte() {
    for other in 0..=255_u8 {
        for count in 0..=8 {
            let mut bytes = *b"12345678________";
            bytes[count] = other;
            if other.is_ascii_digit() && count < 8 {
                continue;
            }
            let expected: u32 = std::str::from_utf8(&b"12345678"[..count]).unwrap().parse().unwrap_or(0);
            assert_eq!(digits(&bytes, 0), Some((expected, count)), "{other} after {count}");
        }
    }
    assert_eq!(digits(b"1234567", 0), None);
}

#[test]
fn what_is_no_number_on_windows_is_none_here() {
    for text in ["nan(ind)", "-nan(ind)", "nan(snan)", "-1.#IND", "1.#QNAN0"] {
        assert!(parse(text.as_bytes()).is_some_and(f64::is_nan), "{text}");
    }
    assert_eq!([parse(b"nan("), parse(b"nan(ind"), parse(b"(nan)")], [None; 3]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn printed_numbers_come_back(value in any::<f64>().prop_filter("finite", |x| x.is_finite())) {
        agrees(&format!("{value}"));
        agrees(&format!("{value:e}"));
    }

    #[test]
    fn decimal_strings_round_as_the_standard_library_does(
        text in "-?[0-9]{1,20}(\\.[0-9]{0,20})?([eE][+-]?[0-9]{1,3})?",
    ) {
        agrees(&text);
    }

    #[test]
    fn short_decimals(text in "-?[0-9]{0,4}\\.[0-9]{1,9}") {
        agrees(&text);
    }
}
