//! Style that fails: what the rooms may import, how long a file may grow, where `unsafe` may stand.
//!
//! The sources are read as text. Every rule is a function from text to complaints, and every rule is shown to fail on
//! a bad sample beside the run over the repository.

use std::fs;
use std::path::{Path, PathBuf};

/// Longest file, tests included.
const LINES_MAX: usize = 800;

/// The only places for `unsafe` in the library.
const UNSAFE_ROOMS: [&str; 3] = ["src/simd/", "src/cache/arena.rs", "src/source/mmap.rs"];

// --- The text of a source file, taken apart -------------------------------------------------------------------------

/// A source file as two texts of equal length and equal lines: code with comments and the insides of strings blanked,
/// and comments alone.
struct Source {
    path: String,
    code: String,
    comments: String,
}

impl Source {
    fn new(path: &str, text: &str) -> Source {
        let (mut code, mut comments) = (String::new(), String::new());
        let mut rest = text;
        while let Some(c) = rest.chars().next() {
            let (length, is_comment, is_blank) = token(rest, code.chars().next_back());
            let (token, tail) = rest.split_at(length.max(c.len_utf8()));
            for c in token.chars() {
                let blank = if c == '\n' { '\n' } else { ' ' };
                code.push(if is_comment || is_blank { blank } else { c });
                comments.push(if is_comment { c } else { blank });
            }
            rest = tail;
        }
        Source { path: path.to_string(), code, comments }
    }

    /// The code without items marked `#[cfg(test)]`; they may import what they test against.
    fn shipped_code(&self) -> String {
        let mut code = self.code.clone();
        while let Some(start) = code.find("#[cfg(test)]") {
            let body = code[start..].find(['{', ';']).map_or(code.len(), |at| start + at);
            let end = if code[body..].starts_with('{') { matching_brace(&code, body) } else { body };
            let blank: String =
                code[start..end].chars().map(|c| if c == '\n' { '\n' } else { ' ' }).collect();
            code.replace_range(start..end, &blank);
        }
        code
    }

    fn complaint(&self, offset: usize, what: &str) -> String {
        let line =
            self.code.chars().take(self.code[..offset].chars().count()).filter(|&c| c == '\n').count() + 1;
        format!("{}:{line}: {what}", self.path)
    }
}

/// Length of the comment, string or character at the start of `rest` (else 0), whether it is a comment, and
/// whether it is to be blanked in the code.
fn token(rest: &str, before: Option<char>) -> (usize, bool, bool) {
    let until = |end: &str, from: usize| rest[from..].find(end).map_or(rest.len(), |at| from + at);
    if rest.starts_with("//") {
        return (until("\n", 0), true, false);
    }
    if rest.starts_with("/*") {
        let (mut depth, mut at) = (0, 0);
        while at < rest.len() {
            if rest[at..].starts_with("/*") {
                depth += 1;
                at += 2;
            } else if rest[at..].starts_with("*/") {
                depth -= 1;
                at += 2;
                if depth == 0 {
                    break;
                }
            } else {
                at += rest[at..].chars().next().map_or(1, char::len_utf8);
            }
        }
        return (at, true, false);
    }
    let in_word = before.is_some_and(|c| c.is_alphanumeric() || c == '_');
    if rest.starts_with('r') && !in_word {
        let hashes = rest[1..].chars().take_while(|&c| c == '#').count();
        if rest[1 + hashes..].starts_with('"') {
            let end = format!("\"{}", "#".repeat(hashes));
            return (until(&end, 2 + hashes) + end.len(), false, true);
        }
    }
    if rest.starts_with('"') {
        return (escaped_length(rest, '"'), false, true);
    }
    // A character, not a lifetime.
    if rest.starts_with("'\\") || rest.chars().nth(2) == Some('\'') && rest.starts_with('\'') {
        return (escaped_length(rest, '\''), false, true);
    }
    (0, false, false)
}

/// Length of a quoted text with its quotes.
fn escaped_length(rest: &str, quote: char) -> usize {
    let mut escaped = false;
    for (at, c) in rest.char_indices().skip(1) {
        match c {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            _ if c == quote => return at + c.len_utf8(),
            _ => {}
        }
    }
    rest.len()
}

fn matching_brace(code: &str, open: usize) -> usize {
    let mut depth = 0;
    for (at, c) in code[open..].char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth == 1 => return open + at + 1,
            '}' => depth -= 1,
            _ => {}
        }
    }
    code.len()
}

/// Places of `word` in `code` that are not part of a longer identifier.
fn words(code: &str, word: &str) -> Vec<usize> {
    let joins = |c: Option<char>| c.is_some_and(|c| c.is_alphanumeric() || c == '_');
    code.match_indices(word)
        .map(|(at, _)| at)
        .filter(|&at| {
            !joins(code[..at].chars().next_back()) && !joins(code[at + word.len()..].chars().next())
        })
        .collect()
}

// --- Rules ----------------------------------------------------------------------------------------------------------

/// The rooms in the order of the list in the crate's documentation.
fn rooms(lib: &str) -> Vec<String> {
    lib.lines()
        .filter_map(|line| line.strip_prefix("//! 1. [`"))
        .filter_map(|line| line.split_once('`'))
        .map(|(room, _)| room.to_string())
        .collect()
}

/// Every module of the crate stands in the list and the other way round.
fn rooms_are_listed(lib: &str) -> Vec<String> {
    let mut declared: Vec<String> = lib
        .lines()
        .filter_map(|line| line.strip_prefix("pub mod ")?.strip_suffix(';'))
        .map(str::to_string)
        .collect();
    let mut listed = rooms(lib);
    declared.sort();
    listed.sort();
    if declared == listed {
        vec![]
    } else {
        vec![format!("src/lib.rs: modules {declared:?}, list {listed:?}")]
    }
}

/// The modules of the crate that the code names.
fn imports(code: &str) -> Vec<(usize, String)> {
    let identifier =
        |text: &str| text.chars().take_while(|&c| c.is_alphanumeric() || c == '_').collect::<String>();
    let mut found = Vec::new();
    for at in words(code, "crate") {
        let Some(path) = code[at..].strip_prefix("crate::") else { continue };
        if path.starts_with('{') {
            let open = at + "crate::".len();
            let group = &code[open + 1..matching_brace(code, open) - 1];
            // Names at depth 0, one after each comma.
            let (mut depth, mut expects) = (0, true);
            for (offset, c) in group.char_indices() {
                match c {
                    '{' => depth += 1,
                    '}' => depth -= 1,
                    ',' if depth == 0 => expects = true,
                    c if expects && c.is_alphabetic() => {
                        found.push((open + 1 + offset, identifier(&group[offset..])));
                        expects = false;
                    }
                    _ => {}
                }
            }
        } else {
            found.push((at, identifier(path)));
        }
    }
    found
}

fn imports_only_upward(source: &Source, rooms: &[String]) -> Vec<String> {
    let Some(room) = source.path.strip_prefix("src/") else { return vec![] };
    let room = room.split(['/', '.']).next().unwrap_or_default();
    let is_test = source.path.ends_with("/tests.rs") || source.path.contains("/tests/");
    let Some(place) = rooms.iter().position(|r| r == room).filter(|_| !is_test) else { return vec![] };
    imports(&source.shipped_code())
        .into_iter()
        .filter(|(_, name)| rooms[place + 1..].contains(name))
        .map(|(at, name)| {
            source.complaint(at, &format!("room `{room}` imports from `{name}`, which is below it"))
        })
        .collect()
}

fn is_short_enough(source: &Source) -> Vec<String> {
    let lines = source.code.lines().count();
    if lines <= LINES_MAX {
        vec![]
    } else {
        vec![format!("{}: {lines} lines, at most {LINES_MAX}", source.path)]
    }
}

fn unsafe_stands_where_it_may(source: &Source) -> Vec<String> {
    if !source.path.starts_with("src/") || UNSAFE_ROOMS.iter().any(|room| source.path.starts_with(room)) {
        return vec![];
    }
    let allowed = UNSAFE_ROOMS.join(", ");
    words(&source.code, "unsafe")
        .into_iter()
        .map(|at| source.complaint(at, &format!("`unsafe` may stand only in {allowed}")))
        .collect()
}

/// Each `unsafe` has a comment that says why it is sound (or, on a declaration, what its caller owes) on its own line or
/// right above the statement.
fn unsafe_is_argued(source: &Source) -> Vec<String> {
    let code: Vec<&str> = source.code.lines().collect();
    let comments: Vec<&str> = source.comments.lines().collect();
    let argued = |line: usize| comments[line].contains("SAFETY:") || comments[line].contains("# Safety");
    let mut complaints = Vec::new();
    for at in words(&source.code, "unsafe") {
        let here = source.code[..at].matches('\n').count();
        let mut line = here;
        let mut found = argued(here);
        // The statement may have started above; then come its comment and attributes.
        while !found && line > 0 {
            line -= 1;
            let text = code[line].trim();
            let is_comment = text.is_empty() && !comments[line].trim().is_empty();
            let continues = !text.is_empty() && !text.ends_with([';', '{', '}', ',']);
            found = is_comment && argued(line);
            if !is_comment && !continues && !text.starts_with("#[") {
                break;
            }
        }
        if !found {
            complaints.push(source.complaint(at, "`unsafe` without a SAFETY comment"));
        }
    }
    complaints
}

/// Nothing unfinished, nothing printed (I8).
fn is_finished_and_silent(source: &Source) -> Vec<String> {
    if !source.path.starts_with("src/") {
        return vec![];
    }
    let mut complaints = Vec::new();
    for mark in ["TODO", "FIXME", "XXX"] {
        complaints.extend(
            words(&source.comments, mark)
                .into_iter()
                .map(|at| format!("{}: {mark} at byte {at}", source.path)),
        );
    }
    for name in ["todo", "unimplemented", "println", "eprintln", "print", "eprint", "dbg"] {
        complaints.extend(
            words(&source.code, name)
                .into_iter()
                .filter(|at| source.code[at + name.len()..].starts_with('!'))
                .map(|at| source.complaint(at, &format!("`{name}!` in the library"))),
        );
    }
    complaints
}

/// The public API speaks in arrays: no type of the vector library in a public signature, field or re-export.
fn keeps_glam_private(source: &Source) -> Vec<String> {
    let is_vector = |name: &str| {
        name == "glam"
            || [
                "Vec2", "Vec3", "Vec3A", "Vec4", "DVec2", "DVec3", "DVec4", "Mat3", "Mat4", "DMat3", "DMat4",
                "Quat",
            ]
            .contains(&name)
    };
    if !source.path.starts_with("src/") {
        return vec![];
    }
    let mut complaints = Vec::new();
    for at in words(&source.code, "pub") {
        let item = &source.code[at + 3..];
        // `pub(crate)` and the like are private to the crate.
        if item.starts_with('(') {
            continue;
        }
        let is_type =
            ["struct", "enum", "union", "trait"].iter().any(|kind| item.trim_start().starts_with(kind));
        // A type's fields and a trait's methods have or need their own `pub`, or count whole below.
        let end = item.find(if is_type { ['{', ';'] } else { ['{', '='] }).unwrap_or(item.len());
        let end = end.min(item.find(";\n").unwrap_or(item.len())).min(item.find(",\n").unwrap_or(item.len()));
        let signature = item[..end].split(|c: char| !(c.is_alphanumeric() || c == '_'));
        if let Some(name) = signature.into_iter().find(|name| is_vector(name)) {
            complaints.push(source.complaint(at, &format!("`{name}` in the public API")));
        }
    }
    complaints
}

/// No path of somebody's machine in any committed text.
fn names_no_machine_path(path: &str, text: &str) -> Vec<String> {
    // Put together here, so that this file does not contain them.
    let roots = [["/ro", "ot/"], ["/ho", "me/"], ["/wo", "rk/"], ["/tmp/", "wt"], ["/Us", "ers/"]]
        .map(|p| p.concat());
    let starts_a_path = |line: &str, root: &str| {
        line.match_indices(root)
            .any(|(at, _)| !line[..at].ends_with(|c: char| c.is_alphanumeric() || "._-".contains(c)))
    };
    text.lines()
        .enumerate()
        .filter_map(|(line, text)| Some((line, roots.iter().find(|root| starts_a_path(text, root))?)))
        .map(|(line, root)| format!("{path}:{}: a path under {root}", line + 1))
        .collect()
}

// --- The repository passes ------------------------------------------------------------------------------------------

/// All text files of the work tree but those that git ignores and lock files, as (path from the root, text).
fn committed_texts() -> Vec<(String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut texts = Vec::new();
    let mut folders = vec![PathBuf::new()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(root.join(&folder)).unwrap() {
            let entry = entry.unwrap();
            let name = entry.file_name().into_string().unwrap();
            let path = folder.join(&name);
            if entry.file_type().unwrap().is_dir() {
                let is_ignored = ["target", ".git", "corpus", "artifacts", "models"].contains(&name.as_str());
                if !is_ignored || path.starts_with("src") {
                    folders.push(path);
                }
            } else if !["Cargo.lock", ".git"].contains(&name.as_str())
                && entry.metadata().unwrap().len() < 1 << 20
                && let Ok(text) = fs::read_to_string(root.join(&path))
            {
                texts.push((path.to_str().unwrap().replace('\\', "/"), text));
            }
        }
    }
    texts.sort();
    texts
}

fn all_complaints(texts: &[(String, String)]) -> Vec<String> {
    let lib = &texts.iter().find(|(path, _)| path == "src/lib.rs").expect("the crate has a root").1;
    let rooms = rooms(lib);
    let mut complaints = rooms_are_listed(lib);
    for (path, text) in texts {
        complaints.extend(names_no_machine_path(path, text));
        if path.ends_with(".rs") {
            let source = Source::new(path, text);
            complaints.extend(imports_only_upward(&source, &rooms));
            for rule in [
                is_short_enough,
                unsafe_stands_where_it_may,
                unsafe_is_argued,
                is_finished_and_silent,
                keeps_glam_private,
            ] {
                complaints.extend(rule(&source));
            }
        }
    }
    complaints
}

#[test]
fn the_repository_is_tidy() {
    let texts = committed_texts();
    let sources = texts.iter().filter(|(path, _)| path.starts_with("src/")).count();
    assert!(sources > 20, "only {sources} sources found: the walk is broken");
    let complaints = all_complaints(&texts);
    assert!(complaints.is_empty(), "{} complaints:\n{}", complaints.len(), complaints.join("\n"));
}

// --- Each rule can fail ---------------------------------------------------------------------------------------------

fn sample(path: &str, text: &str) -> Source {
    Source::new(path, text)
}

#[test]
fn sources_are_taken_apart() {
    let text = "let a = \"// unsafe \\\" {\"; // unsafe\n/* /* unsafe */ */ let c = '\\''; let l: &'static str = r#\"\"unsafe\"#; x::<'a>('\"')\n";
    let source = sample("src/x.rs", text);
    assert!(words(&source.code, "unsafe").is_empty(), "{}", source.code);
    assert_eq!(words(&source.comments, "unsafe").len(), 2);
    assert_eq!(source.code.lines().count(), 2);
    assert!(source.code.contains("'static str =") && source.code.contains("x::<'a>("));
}

#[test]
fn imports_from_below_are_found() {
    let rooms = ["geom", "cache", "octree"].map(str::to_string);
    let complaints = |path: &str, text: &str| imports_only_upward(&sample(path, text), &rooms).len();
    assert_eq!(complaints("src/geom/ray.rs", "use crate::cache::Lru;"), 1);
    assert_eq!(complaints("src/geom/ray.rs", "use crate::{geom::X, cache::{self, octree}, octree::Y};"), 2);
    assert_eq!(complaints("src/geom.rs", "fn f() { crate::octree::g() }"), 1);
    assert_eq!(complaints("src/octree/mod.rs", "use crate::cache::Lru; use crate::geom::Ray;"), 0);
    assert_eq!(
        complaints("src/cache/mod.rs", "// crate::octree\n#[cfg(test)]\nmod t { use crate::octree::X; }"),
        0
    );
    assert_eq!(complaints("src/cache/mod.rs", "#[cfg(test)]\nmod t {}\nuse crate::octree::X;"), 1);
    assert_eq!(complaints("src/cache/tests.rs", "use crate::octree::X;"), 0);
    assert_eq!(rooms_are_listed("//! 1. [`a`]: x\npub mod a;\npub mod b;\n").len(), 1);
    assert_eq!(rooms_are_listed("//! 1. [`b`]: x\n//! 1. [`a`]: x\npub mod a;\npub mod b;\n").len(), 0);
}

#[test]
fn long_files_are_found() {
    assert!(is_short_enough(&sample("src/x.rs", &"x\n".repeat(LINES_MAX))).is_empty());
    assert_eq!(is_short_enough(&sample("src/x.rs", &"x\n".repeat(LINES_MAX + 1))).len(), 1);
}

#[test]
fn unsafe_in_the_wrong_place_is_found() {
    let complaints = |path: &str| unsafe_stands_where_it_may(&sample(path, "unsafe { f() }")).len();
    assert_eq!(["src/octree/node.rs", "src/cache/table.rs", "src/lib.rs"].map(complaints), [1; 3]);
    assert_eq!(["src/simd/avx2.rs", "src/cache/arena.rs", "tests/allocation.rs"].map(complaints), [0; 3]);
    assert!(unsafe_stands_where_it_may(&sample("src/lib.rs", "#![deny(unsafe_op_in_unsafe_fn)]")).is_empty());
}

#[test]
fn unsafe_without_an_argument_is_found() {
    let complaints = |text: &str| unsafe_is_argued(&sample("src/simd/x.rs", text)).len();
    assert_eq!(complaints("fn f() {\n    unsafe { g() }\n}"), 1);
    assert_eq!(complaints("// SAFETY: for the first only.\nunsafe { g() };\nunsafe { h() };"), 1);
    assert_eq!(complaints("// Fast.\nunsafe { g() }"), 1);
    assert_eq!(complaints("let safety = \"SAFETY: text\"; unsafe { g() }"), 1);
    assert_eq!(complaints("// SAFETY: in bounds.\nlet x =\n    unsafe { g() };"), 0);
    assert_eq!(complaints("// SAFETY: Sync, because\n// it is.\n#[allow(x)]\nunsafe impl Sync for X {}"), 0);
    assert_eq!(complaints("/// Does.\n///\n/// # Safety\n/// Owed.\npub unsafe fn f() {}"), 0);
}

#[test]
fn unfinished_and_talkative_code_is_found() {
    let complaints = |text: &str| is_finished_and_silent(&sample("src/x.rs", text)).len();
    for bad in
        ["// TODO: more", "todo!()", "unimplemented!(\"x\")", "println!()", "std::eprintln!(x)", "dbg!(1)"]
    {
        assert_eq!(complaints(bad), 1, "{bad}");
    }
    assert_eq!(complaints("/// println!(\"in an example\")\nlet todo = \"TODO println!\"; fn print() {}"), 0);
}

#[test]
fn glam_in_the_public_api_is_found() {
    let complaints = |text: &str| keeps_glam_private(&sample("src/x.rs", text)).len();
    for bad in [
        "pub use glam::Vec3;",
        "pub fn f(a: Vec3A) -> f32 {\n}",
        "pub struct S {\n    pub at: DVec3,\n    pub x: f32,\n}",
        "pub struct S(pub DVec3);\n",
        "pub type T = [f32; 3];\npub const fn g() -> glam::Mat4 { x }",
    ] {
        assert!(complaints(bad) >= 1, "{bad}");
    }
    let fine = "use glam::Vec3;\npub(crate) fn f(a: Vec3) {}\nfn g(a: Vec3) {}\npub fn h(a: [f32; 3]) { Vec3::from(a); }\npub struct S { at: Vec3 }";
    assert_eq!(complaints(fine), 0);
}

#[test]
fn machine_paths_are_found() {
    let bad = ["cd /ro", "ot/x\n"].concat();
    assert_eq!(names_no_machine_path("README.md", &bad).len(), 1);
    assert_eq!(names_no_machine_path("README.md", &["see `/ho", "me/me/x`"].concat()).len(), 1);
    assert_eq!(names_no_machine_path("README.md", "https://example.org/work/x and src/home/x").len(), 0);
}

#[test]
fn a_bad_repository_is_refused() {
    let text = |path: &str, text: &str| (path.to_string(), text.to_string());
    let good = [text("src/lib.rs", "//! 1. [`a`]: x\npub mod a;\n"), text("src/a.rs", "// Fine.\n")];
    assert!(all_complaints(&good).is_empty());
    let bad = [text("src/lib.rs", "pub mod a;\n"), text("src/a.rs", "unsafe { todo!() }\n")];
    assert_eq!(all_complaints(&bad).len(), 4);
}
