//! Style that fails: what the rooms may import, how long a file may grow, where `unsafe` may stand.
//!
//! The sources are read as text. Every rule is a function from text to complaints, and every rule is shown to fail on
//! a bad sample beside the run over the repository.

use std::fs;
use std::path::{Path, PathBuf};

/// Longest file, tests included.
const LINES_MAX: usize = 800;

/// The only places for `unsafe` in the library.
const UNSAFE_ROOMS: [&str; 4] =
    ["src/simd/", "src/cache/arena.rs", "src/source/mmap.rs", "src/transport/mpi/flight.rs"];

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
    // A method of a trait: what its caller owes stands with the trait.
    let owed_by_trait = |at: usize| {
        source.code[at..].starts_with("unsafe fn")
            && items(&source.code).iter().any(|(start, head, body)| {
                (*start..start + head.len() + body.len()).contains(&at)
                    && head.contains("impl")
                    && head.contains(" for ")
            })
    };
    let mut complaints = Vec::new();
    for at in words(&source.code, "unsafe") {
        if owed_by_trait(at) {
            continue;
        }
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

/// Top-level items of a file: where each starts, its head up to the brace, and its body.
fn items(code: &str) -> Vec<(usize, &str, &str)> {
    let mut items = Vec::new();
    let mut start = 0;
    while let Some(length) = code[start..].find(['{', ';']) {
        let at = start + length;
        // `use a::{b, c};` and `const X: [T; 2] = [...]` end at a semicolon; close enough for their heads.
        let end = if code[at..].starts_with('{') { matching_brace(code, at) } else { at + 1 };
        let skipped = code[start..at].len() - code[start..at].trim_start().len();
        items.push((start + skipped, code[start..at].trim_start(), &code[at..end]));
        start = end;
    }
    items
}

/// Identifiers in the `pub use` statements of a `mod.rs`, and modules that are themselves public.
fn exported_names(mod_code: &str) -> Vec<&str> {
    let statements = words(mod_code, "pub").into_iter().filter_map(|at| {
        let statement = &mod_code[at + 3..];
        let statement = statement.trim_start();
        (statement.starts_with("use ") || statement.starts_with("mod "))
            .then(|| &statement[4..statement.find(';').unwrap_or(statement.len())])
    });
    // In `use a::{b, c}` the path `a` is not exported.
    let names =
        |statement| identifiers(statement).filter(move |name| !statement.contains(&format!("{name}::")));
    statements.flat_map(names).collect()
}

fn identifiers(code: &str) -> impl Iterator<Item = &str> {
    code.split(|c: char| !(c.is_alphanumeric() || c == '_')).filter(|name| !name.is_empty())
}

/// The public API speaks in arrays: no type of the vector library in a public signature, field or re-export. `mod_code` is
/// the code of the `mod.rs` that the file belongs to.
fn keeps_glam_private(source: &Source, mod_code: &str) -> Vec<String> {
    const VECTORS: [&str; 13] = [
        "glam", "Vec2", "Vec3", "Vec3A", "Vec4", "DVec2", "DVec3", "DVec4", "Mat3", "Mat4", "DMat3", "DMat4",
        "Quat",
    ];
    if !source.path.starts_with("src/") {
        return vec![];
    }
    let exported = exported_names(mod_code);
    let file = source.path.rsplit('/').next().unwrap_or_default().trim_end_matches(".rs");
    let in_public_module = file == "mod" || source.path.matches('/').count() == 1 || exported.contains(&file);
    let is_public_name = |name: &str| in_public_module || exported.contains(&name);
    let code = source.shipped_code();
    let mut complaints = Vec::new();
    for (at, head, body) in items(&code) {
        // Attributes before the item.
        let head = head
            .rfind(']')
            .filter(|_| head.starts_with('#'))
            .map_or(head, |end| head[end + 1..].trim_start());
        let mut text = String::new();
        if let Some(declaration) = head.strip_prefix("pub ") {
            let mut names = identifiers(declaration);
            let kind = names.find(|name| !["const", "unsafe", "async", "extern"].contains(name));
            let name = names.next().unwrap_or_default();
            match kind {
                Some("use") => text = format!("{declaration} {body}"),
                _ if !is_public_name(name) => continue,
                Some("enum" | "trait" | "union") => text = format!("{declaration} {body}"),
                Some("struct") => text = format!("{declaration} {}", public_members(body)),
                _ => text = declaration.to_string(),
            }
        } else if head.starts_with("impl") {
            let target = head.rsplit_once(" for ").map_or(head, |(_, target)| target);
            if identifiers(target).any(|name| exported.contains(&name) || in_public_module && name != "impl")
            {
                let is_of_trait = head.contains(" for ");
                text =
                    if is_of_trait { head.to_string() } else { format!("{head} {}", public_members(body)) };
            }
        }
        if let Some(name) = identifiers(&text).find(|name| VECTORS.contains(name)) {
            complaints.push(source.complaint(at, &format!("`{name}` in the public API")));
        }
    }
    complaints
}

/// Signatures of the members of a struct or `impl` body that are plainly `pub`.
fn public_members(body: &str) -> String {
    let ends: &[char] = if body.contains("fn ") { &['{', ';'] } else { &[',', '}'] };
    let members = words(body, "pub").into_iter().filter(|at| !body[at + 3..].starts_with('('));
    let signature = |at: usize| &body[at..][..body[at..].find(ends).unwrap_or(body.len() - at)];
    members.map(signature).collect::<Vec<_>>().join("\n")
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
            for rule in
                [is_short_enough, unsafe_stands_where_it_may, unsafe_is_argued, is_finished_and_silent]
            {
                complaints.extend(rule(&source));
            }
            let folder = path.rsplit_once('/').map_or("", |(folder, _)| folder);
            let mod_file = if folder == "src" { path.clone() } else { format!("{folder}/mod.rs") };
            let mod_text = texts.iter().find(|(path, _)| *path == mod_file).map_or("", |(_, text)| text);
            complaints.extend(keeps_glam_private(&source, &Source::new(&mod_file, mod_text).code));
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
    assert_eq!(complaints("impl S {\n    unsafe fn f() {}\n}"), 1);
    assert_eq!(complaints("impl T for S {\n    unsafe fn f() {\n        unsafe { g() }\n    }\n}"), 1);
    assert_eq!(complaints("impl T for S {\n    unsafe fn f() {}\n}"), 0);
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
    let mod_code = "mod x;\npub use x::{S, f, g};\n";
    let complaints = |text: &str| keeps_glam_private(&sample("src/room/x.rs", text), mod_code).len();
    for bad in [
        "pub use glam::Vec3;",
        "pub fn f(a: Vec3A) -> f32 {\n}",
        "#[inline]\npub const fn g() -> glam::Mat4 { x }",
        "pub struct S {\n    pub at: DVec3,\n    pub x: f32,\n}",
        "pub struct S {\n    pub x: f32,\n    pub at: [DVec3; 2]\n}",
        "pub enum S { A(DVec3) }",
        "pub struct S;\nimpl S {\n    pub fn new(x: Vec3) -> S { S }\n}",
        "impl From<Vec3> for S { fn from(x: Vec3) -> S { S } }",
    ] {
        assert_eq!(complaints(bad), 1, "{bad}");
    }
    for fine in [
        "use glam::Vec3;\npub(crate) fn f(a: Vec3) {}\nfn g(a: Vec3) {}",
        "pub fn f(a: [f32; 3]) { Vec3::from(a); }",
        "pub struct S { at: Vec3, pub(crate) b: Vec3, pub c: f32 }",
        "pub(crate) struct S { pub at: Vec3 }",
        "// Not exported.\npub struct Inner { pub at: Vec3 }\nimpl Inner { pub fn h(&self) -> Vec3 { self.at } }",
        "impl S {\n    fn h(&self) -> Vec3 { x }\n    pub fn k(&self) { let pub_at: Vec3 = x; }\n}",
    ] {
        assert_eq!(complaints(fine), 0, "{fine}");
    }
    // A public module exports all of itself.
    let text = "pub fn anything() -> Vec3 {}";
    assert_eq!(keeps_glam_private(&sample("src/room/x.rs", text), "pub mod x;").len(), 1);
    assert_eq!(keeps_glam_private(&sample("src/room.rs", text), "").len(), 1);
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
