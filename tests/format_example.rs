//! The worked examples of `docs/format.md` are what the library writes.

use outcrop::block::{BlockLimits, Codec};
use outcrop::geom::Precision;
use outcrop::source::testing::memory_model;

const QUAD: [[[f64; 3]; 3]; 2] = [
    [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]],
    [[0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]],
];

/// The bytes of the fenced part of the document that is marked `name`: `offset  hex bytes  | remark`, where `00x24`
/// stands for 24 times `00`.
fn bytes_of(document: &str, name: &str) -> Vec<u8> {
    let (_, rest) = document.split_once(&format!("```text {name}\n")).expect("the document has the example");
    let (example, _) = rest.split_once("```").expect("the example ends");
    let mut bytes = Vec::new();
    for line in example.lines() {
        let (line, _) = line.split_once('|').unwrap_or((line, ""));
        let mut words = line.split_whitespace();
        let offset = words.next().expect("an offset");
        assert_eq!(offset.parse(), Ok(bytes.len()), "offset of the line `{line}`");
        for word in words {
            let (byte, count) = word.split_once('x').unwrap_or((word, "1"));
            let byte = u8::from_str_radix(byte, 16).expect("a byte");
            bytes.extend(std::iter::repeat_n(byte, count.parse().expect("a count")));
        }
    }
    bytes
}

#[test]
fn the_document_shows_what_is_written() {
    let document = include_str!("../docs/format.md");
    let limits = BlockLimits { block_bytes_max: 65536 };
    let file = memory_model(&QUAD, limits, Codec::Raw, Precision::Float32).unwrap();
    let hex = |bytes: &[u8]| {
        let line = |(n, line): (usize, &[u8])| {
            let bytes: Vec<String> = line.iter().map(|byte| format!("{byte:02x}")).collect();
            format!("{:3}  {}", 8 * n, bytes.join(" "))
        };
        bytes.chunks(8).enumerate().map(line).collect::<Vec<_>>().join("\n")
    };
    let block = bytes_of(document, "block");
    let (header, rest) = file.split_at(256);
    assert_eq!(hex(&block), hex(&rest[..block.len()]));
    assert_eq!(hex(&bytes_of(document, "header")), hex(header));
    assert_eq!(hex(&bytes_of(document, "tail")), hex(&rest[block.len()..]));
}
