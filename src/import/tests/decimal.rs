//! Whether f32 keeps the digits of a decimal, against integers of any length.

use dashu::integer::{IBig, UBig};
use proptest::prelude::*;

use super::{obj, ply, stl};
use crate::import::decimal::is_kept_by_float32;
use crate::import::number::{parse, scan};

/// Twice the distance of the number from `nearest`, and a unit of its last digit, both times the same power of ten and of two.
fn doubled_distance_and_unit(text: &str, nearest: f32) -> (IBig, IBig) {
    let (digits, exponent) = match text.split_once(['e', 'E']) {
        Some((digits, exponent)) => (digits, exponent.parse::<i64>().unwrap()),
        None => (text, 0),
    };
    let places = digits.split_once('.').map_or(0, |(_, places)| places.len() as i64);
    let mantissa: IBig = digits.replace('.', "").trim_start_matches('+').parse().unwrap();
    let last = exponent - places;
    // All times 10^600 * 2^150.
    let ten = |exponent: i64| IBig::from(UBig::from(10_u8).pow(usize::try_from(600 + exponent).unwrap()));
    let scale = IBig::from(UBig::from(2_u8).pow(150));
    let bits = nearest.abs().to_bits();
    let (fraction, biased) = (bits & 0x7F_FFFF, (bits >> 23) as usize);
    let significand = IBig::from(if biased == 0 { fraction } else { fraction | 0x80_0000 });
    // A significand counts 2^-149 times 2^(biased - 1).
    let float = significand * IBig::from(UBig::from(2_u8).pow(biased.max(1))) * ten(0);
    let float = if nearest.is_sign_negative() { -float } else { float };
    let distance = mantissa * ten(last) * &scale - float;
    let distance = if distance < IBig::ZERO { -distance } else { distance };
    (distance * IBig::from(2), ten(last) * scale)
}

/// Whether f32 keeps the digits, by the definition.
fn is_kept(text: &str) -> bool {
    let nearest: f32 = text.parse().unwrap();
    if !nearest.is_finite() {
        return false;
    }
    let (doubled_distance, unit) = doubled_distance_and_unit(text, nearest);
    doubled_distance <= unit
}

/// What the room says of a number in digits: by the fast scan, and by the last word. Checks all that does not need the definition.
fn said(text: &str) -> bool {
    let value = parse(text.as_bytes()).unwrap();
    let nearest: f32 = text.parse().unwrap();
    assert_eq!((value as f32).to_bits(), nearest.to_bits(), "{text}: not the nearest f32");
    let is_kept = is_kept_by_float32(text.as_bytes(), value);
    let mut padded = text.as_bytes().to_vec();
    padded.extend_from_slice(&[b'\n'; 32]);
    let (scanned, is_certain, _) = scan(&padded, 0).unwrap();
    assert_eq!(scanned.to_bits(), value.to_bits(), "{text}");
    assert!(is_kept || !is_certain, "{text}: the scan is certain");
    is_kept
}

#[track_caller]
fn agrees(text: &str) -> bool {
    let kept = said(text);
    assert_eq!(kept, is_kept(text), "{text}");
    kept
}

#[test]
fn texts_at_the_borders() {
    for text in [
        "0",
        "-0.000",
        "0.1",
        "123.4567",
        "8388608",
        "16777216",
        "16777216.0",
        "1e38",
        "3.4028235e38",
        "1.5e1",
        "3.4028234663852886e38",
        "1e-45",
        "1.4e-45",
        "2097152.2",
        "2097152.3",
        "2097152.25",
        "0.1000000014901161",
        "0.10000000149011612",
        "0.100000001490116119384765625",
        "0.10000000149011611938476562500000000000000000",
        "-17.25",
        "+17.25",
        "1.17549435e-38",
        "00000000000000000000000.5",
        "0.00000286102294921875",
        "0.0000028610229492187",
        "0.0000028610229492188",
        "340282346638528859811704183484516925440",
        "340282346638528859811704183484516925440.0",
        "1.1754943508222875079687365372222456778186655567720875215087517062784172594547271728515625e-38",
    ] {
        assert!(agrees(text), "{text} is kept");
    }
    for text in [
        "16777217",
        "16777217.0",
        "0.123456789",
        "16777217e0",
        "1e39",
        "1e-46",
        "3.4028236e38",
        "1e400",
        "9007199254740993",
        "0.1000000014901162",
        "0.1000000014901161193847656251",
        "0.30000000000000004",
        "2097152.26",
        "1000000.01",
        "3402823466385288598117041834845169254401",
        "1.23456789e-40",
    ] {
        assert!(!agrees(text), "{text} is not kept");
    }
    // Beyond the reach of the definition's integers.
    for (text, kept) in [
        ("0e-4000", true),
        ("1e-4000", false),
        ("1e-45000000000000", false),
        ("-0e99999999999999999999", true),
    ] {
        assert_eq!(said(text), kept, "{text}");
    }
    for text in ["inf", "-inf", "nan", "infinity", "1.#INF", "-1.#IND00"] {
        assert!(is_kept_by_float32(text.as_bytes(), parse(text.as_bytes()).unwrap()), "{text}");
    }
}

#[test]
fn text_so_near_to_halfway_that_f64_is_halfway_takes_the_right_side() {
    // 1 + 2^-24 and a little: the nearest f64 drops the little, and halfway goes to the even neighbour, 1.
    let text = "1.00000005960464477539062500000000000000000000001";
    let nearest: f64 = text.parse().unwrap();
    assert_eq!((nearest, nearest as f32), (1.0 + 2_f64.powi(-24), 1.0));
    assert_eq!(parse(text.as_bytes()), Some(nearest.next_up()));
    assert_eq!(parse(format!("-{text}").as_bytes()), Some(-nearest.next_up()));
    assert!(!agrees(text));
    let text = "1.000000178813934326171874999999999999999999";
    assert_eq!(parse(text.as_bytes()), Some(text.parse::<f64>().unwrap().next_down()));
    // Exactly halfway stays.
    assert_eq!(parse(b"16777217"), Some(16777217.0));
    assert_eq!(parse(b"1.000000059604644775390625"), Some(1.0 + 2_f64.powi(-24)));
    let mut found = 0;
    for significand in (1 << 23)..(1 << 23) + 4000_u32 {
        // Halfway numbers above 2^33 are whole; three zeros at the end are left to the exponent, and a unit is added or taken.
        let halfway = (f64::from(significand) + 0.5) * 2_f64.powi(40);
        for delta in [-1.0, 0.0, 1.0] {
            let mantissa = (halfway / 1e12).round() + delta;
            found += u32::from(agrees(&format!("{mantissa}e12")));
        }
    }
    assert!(found > 1000);
}

/// Digits of f32 numbers as programs write them.
fn written(x: f32, form: u8) -> String {
    match form {
        // Without an exponent the shortest digits of a large number are filled up with zeros, which count as written.
        0 if x.abs() < 16_777_216.0 => format!("{x}"),
        0 => format!("{x:e}"),
        1 => format!("{x:e}"),
        2 => format!("{x:.8e}"),
        3 => format!("{x:.6}"),
        4 => format!("{x:.9}"),
        5 => format!("{:.16e}", f64::from(x)),
        6 => format!("{:.17}", f64::from(x)),
        7 => format!("{:.5}", x),
        _ => format!("{x:.30}"),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3000))]

    #[test]
    fn what_is_written_from_f32_is_kept(x in any::<f32>().prop_filter("finite", |x| x.is_finite()), small in -999_f32..999.0, form in 0..9_u8) {
        for x in [x, small] {
            let text = written(x, form);
            // A number that fixed places bring down to less is near another f32 by then, which is kept as well.
            prop_assert!(said(&text), "{}", text);
            prop_assert!(is_kept(&text), "{}", text);
        }
    }

    #[test]
    fn decimals_are_kept_or_not_as_integers_say(
        text in "-?[0-9]{1,3}\\.[0-9]{1,12}|-?[0-9]{1,12}\\.[0-9]{0,3}|-?[0-9]{1,22}(\\.[0-9]{0,24})?([eE][+-]?[0-9]{1,2})?",
    ) {
        agrees(&text);
    }

    #[test]
    fn neighbours_of_f32_numbers(x in any::<u32>(), places in 0..60_usize, up in any::<bool>()) {
        // One unit beside f32 written out: the hardest texts to refuse.
        let x = f32::from_bits(x & 0x7FFF_FFFF);
        prop_assume!(x.is_finite() && x < 1e30);
        let text = format!("{x:.places$}");
        let digits: UBig = text.replace('.', "").parse().unwrap();
        let digits = if up || digits == UBig::ZERO { digits + UBig::ONE } else { digits - UBig::ONE };
        let digits = format!("{:0>width$}", digits.to_string(), width = places + 1);
        let (whole, fraction) = digits.split_at(digits.len() - places);
        agrees(&format!("{whole}.{fraction}"));
    }
}

#[test]
fn every_text_format_says_what_f32_keeps() {
    for (number, is_kept) in
        [("0.1", true), ("0.12345678", true), ("123.4567891", false), ("5e-1", true), ("1.00000001e0", false)]
    {
        let kept = if is_kept { 3 } else { 0 };
        // Fast lines, then lines that are read word by word.
        for end in ["\n", " # remark\n"] {
            let (mesh, _) = obj(format!("v 0 0 0\nv 1 0 {number}{end}v 0 1 0\nf 1 2 3\n")).unwrap();
            assert_eq!(
                (mesh.vertices.len(), mesh.float32_text_count, mesh.float32_count),
                (3, kept, 0),
                "{number}"
            );
        }
        let text = format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty float y\nproperty float z\n\
             element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 {number}\n0 1 0\n3 0 1 2\n"
        );
        let (mesh, _) = ply(text).unwrap();
        assert_eq!(
            (mesh.vertices.len(), mesh.float32_text_count, mesh.float32_count),
            (3, kept, 0),
            "{number}"
        );
        let text = format!(
            "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 {number}\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n"
        );
        let (mesh, _) = stl(text).unwrap();
        assert_eq!(
            (mesh.vertices.len(), mesh.float32_text_count, mesh.float32_count),
            (3, kept, 0),
            "{number}"
        );
    }
}
