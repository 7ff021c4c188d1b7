//! The modules of a crate: what each declares, and the paths that its text has.

use anyhow::{Context, Result, anyhow, bail};
use proc_macro2::{Delimiter, Group, TokenStream, TokenTree};
use std::collections::{BTreeMap, BTreeSet};
use std::iter::Peekable;
use std::path::{Path, PathBuf};

/// Segments of a path: of a module from the crate's root, or as the text has it.
pub type Segments = Vec<String>;

/// Modules of a crate by their paths.
pub type Modules = BTreeMap<Segments, Module>;

/// What a module declares and uses.
#[derive(Default)]
pub struct Module {
    /// File with its text.
    pub file: PathBuf,
    /// Names of the modules in it.
    pub children: BTreeSet<String>,
    /// Names of the items that it defines.
    pub items: BTreeSet<String>,
    /// Names that `use` brings into it, with the paths that they stand for.
    pub imports: BTreeMap<String, Segments>,
    /// Paths of which `use` brings in everything.
    pub globs: Vec<Segments>,
    /// Every path in its text.
    pub paths: BTreeSet<Segments>,
}

/// Keywords before the name of an item.
const ITEMS: [&str; 9] = ["fn", "struct", "enum", "union", "trait", "type", "const", "static", "macro_rules"];

/// Reads a crate from its root file on.
///
/// # Errors
/// A file that cannot be read, or is no Rust.
pub fn read(root: &Path) -> Result<Modules> {
    let mut modules = Modules::new();
    read_file(root, folder_of(root), Vec::new(), &mut modules)?;
    Ok(modules)
}

fn folder_of(file: &Path) -> &Path {
    file.parent().unwrap_or(Path::new(""))
}

/// Reads a module whose modules have their files in `folder`.
fn read_file(file: &Path, folder: &Path, path: Segments, modules: &mut Modules) -> Result<()> {
    let text = std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    let tokens: TokenStream =
        text.parse().map_err(|error| anyhow!("cannot read {} as Rust: {error}", file.display()))?;
    read_module(tokens, file, folder, path, modules)
}

fn read_module(
    tokens: TokenStream,
    file: &Path,
    folder: &Path,
    path: Segments,
    modules: &mut Modules,
) -> Result<()> {
    let mut module = Module { file: file.to_path_buf(), ..Module::default() };
    let mut inner = Vec::new();
    scan(tokens, true, &mut module, &mut inner);
    for Declared { name, text, file: given } in inner {
        module.children.insert(name.clone());
        let path = [&path[..], std::slice::from_ref(&name)].concat();
        match (text, given) {
            (Some(text), _) => read_module(text, file, &folder.join(&name), path, modules)?,
            (None, Some(given)) => {
                let file = folder_of(file).join(given);
                read_file(&file, folder_of(&file), path, modules)?;
            }
            (None, None) => {
                let (beside, below) = (folder.join(format!("{name}.rs")), folder.join(&name).join("mod.rs"));
                let Some(file) = [beside, below].into_iter().find(|file| file.is_file()) else {
                    bail!("{}: no file of the module {name}", file.display());
                };
                read_file(&file, &folder.join(&name), path, modules)?;
            }
        }
    }
    modules.insert(path, module);
    Ok(())
}

/// A module as its parent declares it: with its text, with the name of its file, or with neither.
struct Declared {
    name: String,
    text: Option<TokenStream>,
    file: Option<String>,
}

type Tokens = Peekable<proc_macro2::token_stream::IntoIter>;

/// Collects what a text declares and uses. `outer` is the level of the module's items; below it are their bodies.
fn scan(tokens: TokenStream, outer: bool, module: &mut Module, inner: &mut Vec<Declared>) {
    let mut tokens: Tokens = tokens.into_iter().peekable();
    let mut file = None;
    while let Some(token) = tokens.next() {
        match token {
            TokenTree::Punct(punct) if punct.as_char() == '#' => {
                let of_all = tokens.next_if(|next| is(next, '!')).is_some();
                let Some(TokenTree::Group(attribute)) = tokens.peek() else { continue };
                let text = attribute.stream().to_string().replace(' ', "");
                tokens.next();
                if text.starts_with("cfg(test") || text.starts_with("cfg(all(test") {
                    if of_all {
                        return;
                    }
                    file = None;
                    skip_item(&mut tokens);
                } else if let Some(given) = text.strip_prefix("path=") {
                    file = Some(given.trim_matches('"').to_owned());
                }
            }
            TokenTree::Group(group) => scan(group.stream(), false, module, inner),
            TokenTree::Ident(ident) => match ident.to_string().as_str() {
                "mod" => {
                    let Some(TokenTree::Ident(name)) = tokens.next() else { continue };
                    let text = match tokens.next() {
                        Some(TokenTree::Group(group)) => Some(group.stream()),
                        _ => None,
                    };
                    inner.push(Declared { name: name.to_string(), text, file: file.take() });
                }
                // Not the `use<'a>` of a type.
                "use" if !tokens.peek().is_some_and(|next| is(next, '<')) => {
                    use_tree(&mut tokens, &[], module);
                }
                keyword if outer && ITEMS.contains(&keyword) => {
                    tokens.next_if(|next| is(next, '!'));
                    if let Some(TokenTree::Ident(name)) = tokens.peek() {
                        module.items.insert(name.to_string());
                    }
                }
                first => {
                    let mut path = vec![first.to_owned()];
                    while double_colon(&mut tokens) {
                        let Some(TokenTree::Ident(next)) = tokens.peek() else { break };
                        path.push(next.to_string());
                        tokens.next();
                    }
                    if path.len() > 1 {
                        module.paths.insert(path);
                    }
                }
            },
            TokenTree::Punct(_) | TokenTree::Literal(_) => {}
        }
    }
}

fn is(token: &TokenTree, mark: char) -> bool {
    matches!(token, TokenTree::Punct(punct) if punct.as_char() == mark)
}

/// Takes `::`, if it comes next.
fn double_colon(tokens: &mut Tokens) -> bool {
    let mut ahead = tokens.clone();
    let is_next = ahead.next().is_some_and(|token| is(&token, ':'))
        && ahead.next().is_some_and(|token| is(&token, ':'));
    if is_next {
        *tokens = ahead;
    }
    is_next
}

/// Skips an item of tests: to its semicolon or its body.
fn skip_item(tokens: &mut Tokens) {
    for token in tokens.by_ref() {
        match token {
            TokenTree::Punct(punct) if punct.as_char() == ';' => return,
            TokenTree::Group(group) if group.delimiter() == Delimiter::Brace => return,
            _ => {}
        }
    }
}

/// Reads what follows `use`, or a branch of its tree, after the segments `before`.
fn use_tree(tokens: &mut Tokens, before: &[String], module: &mut Module) {
    let mut path = before.to_vec();
    let mut alias = None;
    while let Some(token) = tokens.next() {
        match token {
            TokenTree::Ident(ident) if ident == "as" => {
                alias = tokens.next().map(|name| name.to_string());
            }
            TokenTree::Ident(ident) => path.push(ident.to_string()),
            TokenTree::Punct(punct) if punct.as_char() == '*' => {
                module.paths.insert(path.clone());
                module.globs.push(path);
                path = Vec::new();
            }
            TokenTree::Punct(punct) if punct.as_char() == ':' => {}
            TokenTree::Group(group) => {
                branches(&group, &path, module);
                path = Vec::new();
            }
            // The end of the statement, or of the branch.
            _ => break,
        }
    }
    if path.len() > 1 && path.last().is_some_and(|last| last == "self") {
        path.pop();
    }
    if let Some(last) = path.last().cloned() {
        module.imports.insert(alias.unwrap_or(last), path.clone());
        module.paths.insert(path);
    }
}

fn branches(group: &Group, before: &[String], module: &mut Module) {
    let mut tokens: Tokens = group.stream().into_iter().peekable();
    while tokens.peek().is_some() {
        use_tree(&mut tokens, before, module);
    }
}
