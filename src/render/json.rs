//! Just enough JSON for a report: objects of numbers, texts and objects.

use std::fmt::Write as _;

/// Writes one JSON object, member by member.
pub(super) struct JsonObject {
    text: String,
}

impl JsonObject {
    pub fn new() -> JsonObject {
        JsonObject { text: String::from("{") }
    }

    /// A member whose value is JSON already.
    pub fn raw(mut self, name: &str, value: &str) -> JsonObject {
        if self.text.len() > 1 {
            self.text.push(',');
        }
        quote(name, &mut self.text);
        self.text.push(':');
        self.text.push_str(value);
        self
    }

    pub fn count(self, name: &str, value: u64) -> JsonObject {
        self.raw(name, &value.to_string())
    }

    /// A number; `null` if it is not finite, as JSON has no name for that.
    pub fn number(self, name: &str, value: f64) -> JsonObject {
        self.raw(name, &if value.is_finite() { value.to_string() } else { "null".to_string() })
    }

    pub fn flag(self, name: &str, value: bool) -> JsonObject {
        self.raw(name, if value { "true" } else { "false" })
    }

    pub fn text(self, name: &str, value: &str) -> JsonObject {
        let mut quoted = String::new();
        quote(value, &mut quoted);
        self.raw(name, &quoted)
    }

    pub fn end(mut self) -> String {
        self.text.push('}');
        self.text
    }
}

/// A JSON array of values that are JSON already.
pub(super) fn array(values: impl IntoIterator<Item = String>) -> String {
    let values: Vec<String> = values.into_iter().collect();
    format!("[{}]", values.join(","))
}

fn quote(text: &str, into: &mut String) {
    into.push('"');
    for character in text.chars() {
        match character {
            '"' => into.push_str("\\\""),
            '\\' => into.push_str("\\\\"),
            control if control < ' ' => {
                // Writing to a String cannot fail.
                let _ = write!(into, "\\u{:04x}", control as u32);
            }
            other => into.push(other),
        }
    }
    into.push('"');
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parser_reads_it_back() {
        let nasty = "quote \" backslash \\ newline \n tab \t bell \u{7} \u{1f980}";
        let text = JsonObject::new()
            .text(nasty, nasty)
            .count("count", u64::MAX)
            .number("number", 0.1)
            .number("infinite", f64::INFINITY)
            .flag("flag", true)
            .raw("list", &array(["1".to_string(), JsonObject::new().end()]))
            .end();
        let value: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(value[nasty], nasty);
        assert_eq!(value["count"], u64::MAX);
        assert_eq!(value["number"], 0.1);
        assert!(value["infinite"].is_null() && value["flag"] == true);
        assert_eq!(value["list"], serde_json::json!([1, {}]));
    }
}
