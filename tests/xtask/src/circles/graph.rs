//! Which sibling modules use which, and the circles among them.

use super::modules::{Modules, Segments};
use std::collections::{BTreeMap, BTreeSet};

/// Sibling modules that use each other.
pub struct Circle {
    /// Crate, parent and modules: `host/device: link: client, error`.
    pub name: String,
    /// The imports among them: modules, file and path.
    pub imports: Vec<String>,
}

/// Longest chain of re-exports that is followed.
const MAX_REEXPORTS: usize = 16;

/// Imports among the modules of one parent: from, to, and where.
type Imports = BTreeMap<(String, String), String>;

/// All circles of a crate.
pub fn circles(folder: &str, modules: &Modules) -> Vec<Circle> {
    let mut of_parents: BTreeMap<Segments, Imports> = BTreeMap::new();
    for (from, module) in modules {
        for path in &module.paths {
            let Some(to) = resolve(modules, from, path, MAX_REEXPORTS) else { continue };
            let shared = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
            if let (Some(a), Some(b)) = (from.get(shared), to.get(shared)) {
                let place = format!("{a} -> {b}: {} uses {}", module.file.display(), path.join("::"));
                let imports = of_parents.entry(from[..shared].to_vec()).or_default();
                imports.entry((a.clone(), b.clone())).or_insert(place);
            }
        }
    }
    let mut circles = Vec::new();
    for (parent, imports) in &of_parents {
        let mut done: BTreeSet<&String> = BTreeSet::new();
        for (from, _) in imports.keys() {
            let reached = reachable(imports, from);
            if done.contains(from) || !reached.contains(from) {
                continue;
            }
            let members: BTreeSet<&String> =
                reached.into_iter().filter(|one| reachable(imports, one).contains(from)).collect();
            done.extend(&members);
            let names = members.iter().map(|one| one.as_str()).collect::<Vec<_>>().join(", ");
            let name = [&[folder.to_owned()], &parent[..], &[names]].concat().join(": ");
            let among = |(from, to): &(String, String)| members.contains(from) && members.contains(to);
            let imports =
                imports.iter().filter(|(pair, _)| among(pair)).map(|(_, place)| place.clone()).collect();
            circles.push(Circle { name, imports });
        }
    }
    circles
}

/// Modules that a module uses, directly or through others.
fn reachable<'a>(imports: &'a Imports, from: &String) -> BTreeSet<&'a String> {
    let mut reached = BTreeSet::new();
    let mut open = vec![from];
    while let Some(one) = open.pop() {
        for (_, to) in imports.keys().filter(|(from, _)| from == one) {
            if reached.insert(to) {
                open.push(to);
            }
        }
    }
    reached
}

/// The module that a path names, or that defines the item it names; none for what is of other crates.
fn resolve(modules: &Modules, at: &[String], path: &[String], reexports: usize) -> Option<Segments> {
    let (first, mut rest) = path.split_first()?;
    let mut here: Segments = match first.as_str() {
        "crate" => Vec::new(),
        "self" => at.to_vec(),
        "super" => at.split_last()?.1.to_vec(),
        name if modules.get(at)?.children.contains(name) => [at, std::slice::from_ref(first)].concat(),
        name => {
            let meant = modules.get(at)?.imports.get(name).filter(|meant| *meant != path)?;
            resolve(modules, at, meant, reexports.checked_sub(1)?)?
        }
    };
    while let Some((name, after)) = rest.split_first() {
        rest = after;
        let module = modules.get(&here)?;
        if name == "super" {
            here.pop()?;
        } else if module.children.contains(name) {
            here.push(name.clone());
        } else if let Some(meant) = module.imports.get(name) {
            match resolve(modules, &here, meant, reexports.checked_sub(1)?) {
                Some(owner) => here = owner,
                None => return Some(here),
            }
        } else if module.items.contains(name) {
            return Some(here);
        } else {
            let defines = |of: &Segments| {
                modules.get(of).is_some_and(|of| of.items.contains(name) || of.imports.contains_key(name))
            };
            let reexports = reexports.checked_sub(1)?;
            let mut globs = module.globs.iter().filter_map(|glob| resolve(modules, &here, glob, reexports));
            return Some(globs.find(defines).unwrap_or(here));
        }
    }
    Some(here)
}

#[cfg(test)]
mod tests {
    use super::super::modules;
    use super::*;
    use std::path::Path;

    /// Circles of a crate with these files.
    fn found(name: &str, files: &[(&str, &str)]) -> Vec<String> {
        let folder = std::env::temp_dir().join(format!("circles-{}-{name}", std::process::id()));
        for (file, text) in files {
            let file = folder.join(file);
            std::fs::create_dir_all(file.parent().unwrap_or(Path::new(""))).expect("a folder");
            std::fs::write(file, text).expect("a file");
        }
        let modules = modules::read(&folder.join("lib.rs")).expect("Rust");
        std::fs::remove_dir_all(&folder).expect("the folder can be removed");
        circles("one", &modules).into_iter().map(|circle| circle.name).collect()
    }

    #[test]
    fn finds_two_modules_that_use_each_other_by_use_and_by_path() {
        let files = [
            ("lib.rs", "mod a; mod b; mod c;"),
            ("a.rs", "use crate::b::{self, x::{Y as Z}}; pub struct A;"),
            ("b/mod.rs", "pub mod x;"),
            ("b/x.rs", "pub struct Y; fn f() -> Vec<crate::a::A> { Vec::new() }"),
            ("c.rs", "use crate::{a, b};"),
        ];
        assert_eq!(found("two", &files), ["one: a, b"]);
    }

    #[test]
    fn finds_a_circle_of_three_below_the_root() {
        let files = [
            ("lib.rs", "pub mod p { pub mod a; pub mod b; pub mod c; }"),
            ("p/a.rs", "use super::b::B; pub struct A;"),
            ("p/b.rs", "macro_rules! m { () => { $crate::p::c::C } } pub struct B;"),
            ("p/c.rs", "pub struct C; fn f(_: super::super::p::a::A) {}"),
        ];
        assert_eq!(found("three", &files), ["one: p: a, b, c"]);
    }

    #[test]
    fn follows_names_that_a_parent_re_exports() {
        let files = [
            ("lib.rs", "mod a; mod b; pub use a::*; pub use b::B as Other;"),
            ("a.rs", "pub struct A; fn f(_: crate::Other) {}"),
            ("b.rs", "pub struct B; use super::A;"),
        ];
        assert_eq!(found("exports", &files), ["one: a, b"]);
    }

    #[test]
    fn ignores_tests_comments_strings_other_crates_and_what_the_parent_defines() {
        let files = [
            ("lib.rs", "mod a; mod b; pub struct Shared; pub use other::Third;"),
            ("a.rs", "use crate::{Shared, Third, b::B}; #[cfg(test)] mod tests { use crate::b::B; }"),
            (
                "b.rs",
                "//! [`crate::a::A`]\nuse a::A; pub struct B; const S: &str = \"crate::a::A\"; // crate::a::A\n\
                 #[cfg(test)] use crate::a::A; fn f<'a>(s: super::Shared) -> impl Sized + use<'a> { s }",
            ),
        ];
        assert!(found("ignored", &files).is_empty());
    }

    #[test]
    fn reads_a_module_from_the_file_that_its_path_names() {
        let files = [
            ("lib.rs", "#[path = \"elsewhere/x.rs\"] mod a; mod b;"),
            ("elsewhere/x.rs", "use crate::b::B; pub struct A;"),
            ("b.rs", "pub struct B; impl From<crate::a::A> for B {}"),
        ];
        assert_eq!(found("path", &files), ["one: a, b"]);
    }
}
