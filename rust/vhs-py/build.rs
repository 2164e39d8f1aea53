//! Takes the docstrings out of the stub, so that `help()` in Python says what the stub says.
//!
//! Each goes to a file of its own, `Class.txt`, `Class.method.txt` or `function.txt`, which `stub!` includes.

use std::fs;
use std::path::{Path, PathBuf};

const STUB: &str = "../../python/vhs/_core.pyi";

fn main() {
    println!("cargo::rerun-if-changed={STUB}");
    println!("cargo::rerun-if-changed=build.rs");
    let stub = fs::read_to_string(STUB).expect("the stub beside the crate");
    let out = PathBuf::from(std::env::var_os("OUT_DIR").expect("set by cargo"));
    let mut docs = docstrings(&stub);
    // A class is called to make one: its text ends with that of its constructor.
    for (name, text) in docs.clone() {
        if let Some(class) = name.strip_suffix(".__new__") {
            let whole = docs.iter_mut().find(|(name, _)| name == class);
            let (_, whole) = whole.expect("a documented class");
            *whole = format!("{whole}\n\n{text}");
        }
    }
    for (name, text) in docs {
        write(&out, &name, &text);
    }
}

fn write(out: &Path, name: &str, text: &str) {
    fs::write(out.join(format!("{name}.txt")), text).expect("a writable folder");
}

/// Name and text of every docstring: that of a class, or of a function of a class or of none.
fn docstrings(stub: &str) -> Vec<(String, String)> {
    let mut docs = Vec::new();
    let (mut class, mut name) = (String::new(), String::new());
    let mut lines = stub.lines();
    while let Some(line) = lines.next() {
        let code = line.trim_start();
        let is_inner = code.len() < line.len();
        if let Some(rest) = code.strip_prefix("class ") {
            class = identifier(rest);
            name.clone_from(&class);
        } else if let Some(rest) = code.strip_prefix("def ") {
            let function = identifier(rest);
            name = if is_inner {
                format!("{class}.{function}")
            } else {
                function
            };
        } else if let Some(first) = code.strip_prefix("\"\"\"") {
            let indent = line.len() - code.len();
            let text = docstring(first, indent, &mut lines);
            if !name.is_empty() {
                docs.push((std::mem::take(&mut name), text));
            }
        }
    }
    docs
}

fn identifier(code: &str) -> String {
    let end = code.find(|c: char| !c.is_alphanumeric() && c != '_');
    code[..end.unwrap_or(code.len())].into()
}

/// The rest of a docstring that begins so, without its indentation.
fn docstring<'a>(first: &str, indent: usize, lines: &mut impl Iterator<Item = &'a str>) -> String {
    if let Some(text) = first.strip_suffix("\"\"\"") {
        return text.into();
    }
    let mut text = vec![first];
    for line in lines {
        let line = line.get(indent..).unwrap_or_default();
        if let Some(last) = line.strip_suffix("\"\"\"") {
            text.push(last);
            break;
        }
        text.push(line);
    }
    text.join("\n").trim_end().into()
}
