//! A crate's source files as a graph: for each file, the other files that its code names.
//!
//! Input: `src`, from `lib.rs` and `main.rs` along the `mod` declarations. Output: every
//! [`SourceFile`] with the paths in its code, resolved to files. Paths are read from `use` trees,
//! expressions, types, patterns, attributes' strings, and the tokens of macro calls. A path begins
//! with `crate`, `self`, `super`, or a child module. In doc comments, only paths from `crate` are
//! read, and marked. A re-export counts as the file with the
//! `pub use`: its users depend on all dependencies of this file.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use proc_macro2::{Delimiter, Span, TokenStream, TokenTree};
use syn::spanned::Spanned;
use syn::visit::{self, Visit};

/// A place where a file names an item of another module of the crate.
pub struct Import {
    /// The path from the crate's root.
    pub path: Vec<String>,
    /// Whether the last name can be a module, as in a `use`; in a call it cannot.
    pub ends_in_module: bool,
    /// The line.
    pub line: usize,
    /// Whether it is in code that is built for tests only.
    pub test: bool,
    /// Whether it is in a doc comment.
    pub doc: bool,
}

/// A function or method.
pub struct Function {
    pub name: String,
    /// Line of `fn`.
    pub line: usize,
    /// Lines from `fn` to the closing brace.
    pub lines: usize,
    /// Whether it is built for tests only.
    pub test: bool,
}

/// A file of the crate.
pub struct SourceFile {
    /// Its path from the root of the repository.
    pub path: String,
    /// Its module path; empty for `lib.rs`.
    pub module: Vec<String>,
    pub text: String,
    /// Whether all of it is built for tests only.
    pub test: bool,
    /// Lines of items that are built for tests only.
    pub test_lines: Vec<RangeInclusive<usize>>,
    pub imports: Vec<Import>,
    pub functions: Vec<Function>,
}

impl SourceFile {
    fn forget(&mut self) {
        (self.test_lines, self.imports, self.functions) = Default::default();
    }

    /// The lines that are not for tests only, with their line numbers.
    pub fn product_lines(&self) -> impl Iterator<Item = (usize, &str)> {
        let tests_only = |line: usize| self.test || self.test_lines.iter().any(|range| range.contains(&line));
        (1..).zip(self.text.lines()).filter(move |(line, _)| !tests_only(*line))
    }
}

/// All files of a crate.
pub struct Sources {
    pub files: Vec<SourceFile>,
    by_module: BTreeMap<Vec<String>, usize>,
}

impl Sources {
    /// Reads the crate at a root.
    pub fn read(root: &Path) -> Sources {
        let mut files = Vec::new();
        read_module(root, &root.join("src/lib.rs"), Vec::new(), false, &mut files);
        let program = root.join("src/main.rs");
        if program.is_file() {
            read_module(root, &program, vec!["main".to_string()], false, &mut files);
        }
        files.sort_by(|a, b| a.0.path.cmp(&b.0.path));
        let (mut files, syntax): (Vec<SourceFile>, Vec<syn::File>) = files.into_iter().unzip();
        let by_module: BTreeMap<_, _> = files.iter().enumerate().map(|(i, file)| (file.module.clone(), i)).collect();
        let modules: BTreeSet<Vec<String>> = by_module.keys().cloned().collect();
        for (file, syntax) in files.iter_mut().zip(&syntax) {
            let (here, test) = (file.module.clone(), file.test);
            let mut reader = Reader { modules: &modules, here, test, doc: false, renamed: BTreeMap::new(), file };
            // The first pass finds the modules that `use` brings into scope, the second the paths
            // through them.
            reader.visit_file(syntax);
            reader.file.forget();
            reader.visit_file(syntax);
        }
        Sources { files, by_module }
    }

    /// The file of an import: the one with the longest module path that begins its path.
    pub fn target(&self, import: &Import) -> usize {
        let most = import.path.len() - usize::from(!import.ends_in_module && !import.path.is_empty());
        (0..=most).rev().find_map(|n| self.by_module.get(&import.path[..n])).copied().expect("lib.rs is the root")
    }

    /// For each file, the files that its code names, with the names and lines; without test code.
    /// `docs` adds the files that its doc comments name.
    pub fn graph(&self, docs: bool) -> Vec<BTreeMap<usize, Vec<String>>> {
        let edges = |(index, file): (usize, &SourceFile)| {
            let mut edges: BTreeMap<usize, Vec<String>> = BTreeMap::new();
            for import in file.imports.iter().filter(|import| !import.test && (docs || !import.doc)) {
                let target = self.target(import);
                if target != index {
                    edges.entry(target).or_default().push(format!("{}:{}", import.path.join("::"), import.line));
                }
            }
            edges
        };
        self.files.iter().enumerate().map(edges).collect()
    }
}

/// Whether attributes mark an item as built for tests only.
pub fn is_test(attributes: &[syn::Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        let syn::Meta::List(list) = &attribute.meta else { return false };
        list.path.is_ident("cfg") && {
            let tokens = list.tokens.to_string();
            tokens == "test" || tokens.replace(' ', "").starts_with("all(test,")
        }
    })
}

fn read_module(root: &Path, path: &Path, module: Vec<String>, test: bool, files: &mut Vec<(SourceFile, syn::File)>) {
    let text = fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let syntax = syn::parse_file(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let stem = path.file_stem().unwrap().to_string_lossy().into_owned();
    let folder = match stem.as_str() {
        "lib" | "main" | "mod" => path.parent().unwrap().to_path_buf(),
        _ => path.with_extension(""),
    };
    declared(root, &folder, &module, &syntax.items, test, files);
    let path = path.strip_prefix(root).unwrap().to_string_lossy().into_owned();
    let (test_lines, imports, functions) = Default::default();
    let file = SourceFile { path, module, text, test, test_lines, imports, functions };
    files.push((file, syntax));
}

/// Reads the files of `mod` declarations.
fn declared(
    root: &Path,
    folder: &Path,
    module: &[String],
    items: &[syn::Item],
    test: bool,
    files: &mut Vec<(SourceFile, syn::File)>,
) {
    for item in items {
        let syn::Item::Mod(item) = item else { continue };
        let name = item.ident.to_string();
        let child: Vec<String> = module.iter().cloned().chain([name.clone()]).collect();
        let test = test || is_test(&item.attrs);
        match &item.content {
            Some((_, items)) => declared(root, &folder.join(&name), &child, items, test, files),
            None => {
                let flat: PathBuf = folder.join(format!("{name}.rs"));
                let path = if flat.is_file() { flat } else { folder.join(&name).join("mod.rs") };
                read_module(root, &path, child, test, files);
            }
        }
    }
}

struct Reader<'a> {
    modules: &'a BTreeSet<Vec<String>>,
    here: Vec<String>,
    test: bool,
    doc: bool,
    /// Modules in the `use` items of this file, by local name.
    renamed: BTreeMap<String, Vec<String>>,
    file: &'a mut SourceFile,
}

impl Reader<'_> {
    /// Records a path; returns its form from the crate's root, if it is in the crate.
    fn name(&mut self, path: &[String], ends_in_module: bool, span: Span) -> Option<Vec<String>> {
        let mut here = self.here.clone();
        let rest = match path.first().map(String::as_str) {
            Some("crate") => {
                here.clear();
                &path[1..]
            }
            Some("nsim") if self.here == ["main"] => {
                here.clear();
                &path[1..]
            }
            Some("self") => &path[1..],
            Some("super") => {
                let ups = path.iter().take_while(|name| *name == "super").count();
                here.truncate(here.len().saturating_sub(ups));
                &path[ups..]
            }
            Some(first) => {
                here.push(first.to_string());
                if !self.modules.contains(&here) {
                    here.clone_from(self.renamed.get(first)?);
                }
                &path[1..]
            }
            None => return None,
        };
        here.extend(rest.iter().cloned());
        let line = span.start().line;
        self.file.imports.push(Import { path: here.clone(), ends_in_module, line, test: self.test, doc: self.doc });
        Some(here)
    }

    fn use_tree(&mut self, before: &mut Vec<String>, tree: &syn::UseTree) {
        match tree {
            syn::UseTree::Path(path) => {
                before.push(path.ident.to_string());
                self.use_tree(before, &path.tree);
                before.pop();
            }
            syn::UseTree::Group(group) => group.items.iter().for_each(|tree| self.use_tree(before, tree)),
            syn::UseTree::Glob(glob) => drop(self.name(before, true, glob.span())),
            syn::UseTree::Name(name) => self.use_name(before, &name.ident, &name.ident),
            syn::UseTree::Rename(rename) => self.use_name(before, &rename.ident, &rename.rename),
        }
    }

    fn use_name(&mut self, before: &[String], name: &syn::Ident, within: &syn::Ident) {
        let path: Vec<String> = before.iter().cloned().chain((name != "self").then(|| name.to_string())).collect();
        if let Some(module) = self.name(&path, true, name.span()).filter(|path| self.modules.contains(path)) {
            let within = if within == "self" { path.last().unwrap().clone() } else { within.to_string() };
            self.renamed.insert(within, module);
        }
    }

    /// Finds paths among unparsed tokens: names joined by two colons.
    fn tokens(&mut self, tokens: TokenStream) {
        let (mut path, mut colons, mut begin) = (Vec::new(), 0, None);
        for token in tokens {
            match token {
                TokenTree::Ident(ident) if colons == 2 && !path.is_empty() => {
                    path.push(ident.to_string());
                    colons = 0;
                }
                TokenTree::Ident(ident) => {
                    self.end_of_path(&mut path, begin);
                    (begin, colons) = (Some(ident.span()), 0);
                    path.push(ident.to_string());
                }
                TokenTree::Punct(punct) if punct.as_char() == ':' => colons += 1,
                TokenTree::Group(group) => {
                    if colons == 2
                        && group.delimiter() == Delimiter::Brace
                        && path.first().is_some_and(|n| n == "crate")
                    {
                        panic!("{}: a use tree within a macro", self.file.path);
                    }
                    self.end_of_path(&mut path, begin);
                    colons = 0;
                    self.tokens(group.stream());
                }
                token => {
                    self.end_of_path(&mut path, begin);
                    colons = 0;
                    // A doc comment in a macro call.
                    if let TokenTree::Literal(literal) = token
                        && let Ok(text) = syn::parse_str(&literal.to_string())
                    {
                        self.doc_paths(&text);
                    }
                }
            }
        }
        self.end_of_path(&mut path, begin);
    }

    /// Finds the paths from the crate's root in a doc comment.
    fn doc_paths(&mut self, text: &syn::LitStr) {
        self.doc = true;
        for names in text.value().split("crate::").skip(1) {
            let names = names.split(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':')).next().unwrap();
            let path: Vec<String> = ["crate"].into_iter().chain(names.split("::")).map(str::to_string).collect();
            self.name(&path, true, text.span());
        }
        self.doc = false;
    }

    fn end_of_path(&mut self, path: &mut Vec<String>, begin: Option<Span>) {
        if let (2.., Some(span)) = (path.len(), begin) {
            self.name(path, false, span);
        }
        path.clear();
    }

    /// Records a function that ends at a line.
    fn function(&mut self, signature: &syn::Signature, attributes: &[syn::Attribute], end: Span) {
        let line = signature.span().start().line;
        let lines = end.end().line + 1 - line;
        let test = self.test || is_test(attributes);
        self.file.functions.push(Function { name: signature.ident.to_string(), line, lines, test });
    }

    /// Visits an item, and records whether it is for tests only.
    fn item(&mut self, attributes: &[syn::Attribute], span: Span, visit: impl FnOnce(&mut Self)) {
        let before = self.test;
        if is_test(attributes) && !before {
            self.file.test_lines.push(span.start().line..=span.end().line);
            self.test = true;
        }
        visit(self);
        self.test = before;
    }
}

/// Overrides for nodes that may be built for tests only.
macro_rules! items {
    ($($method:ident: $node:ident),*; functions $($function:ident: $function_node:ident),*) => {
        $(fn $method(&mut self, node: &'ast syn::$node) {
            self.item(&node.attrs, node.span(), |reader| visit::$method(reader, node));
        })*
        $(fn $function(&mut self, node: &'ast syn::$function_node) {
            self.function(&node.sig, &node.attrs, node.span());
            self.item(&node.attrs, node.span(), |reader| visit::$function(reader, node));
        })*
    };
}

impl<'ast> Visit<'ast> for Reader<'_> {
    items! {
        visit_item_const: ItemConst, visit_item_enum: ItemEnum, visit_item_impl: ItemImpl,
        visit_item_macro: ItemMacro, visit_item_static: ItemStatic, visit_item_struct: ItemStruct,
        visit_item_trait: ItemTrait, visit_item_type: ItemType, visit_impl_item_const: ImplItemConst,
        visit_local: Local;
        functions visit_item_fn: ItemFn, visit_impl_item_fn: ImplItemFn, visit_trait_item_fn: TraitItemFn
    }

    fn visit_item_mod(&mut self, node: &'ast syn::ItemMod) {
        self.item(&node.attrs, node.span(), |reader| {
            reader.here.push(node.ident.to_string());
            visit::visit_item_mod(reader, node);
            reader.here.pop();
        });
    }

    fn visit_item_use(&mut self, node: &'ast syn::ItemUse) {
        self.item(&node.attrs, node.span(), |reader| reader.use_tree(&mut Vec::new(), &node.tree));
    }

    fn visit_path(&mut self, node: &'ast syn::Path) {
        let path: Vec<String> = node.segments.iter().map(|segment| segment.ident.to_string()).collect();
        if node.leading_colon.is_none() && path.len() > 1 {
            self.name(&path, false, node.span());
        }
        visit::visit_path(self, node);
    }

    fn visit_macro(&mut self, node: &'ast syn::Macro) {
        self.tokens(node.tokens.clone());
        visit::visit_macro(self, node);
    }

    fn visit_attribute(&mut self, node: &'ast syn::Attribute) {
        if let syn::Meta::NameValue(syn::MetaNameValue { value: syn::Expr::Lit(value), .. }) = &node.meta
            && let syn::Lit::Str(text) = &value.lit
        {
            self.doc_paths(text);
        }
        let syn::Meta::List(list) = &node.meta else { return };
        let strings = list.tokens.clone().into_iter().filter_map(|token| match token {
            TokenTree::Literal(literal) => syn::parse_str::<syn::LitStr>(&literal.to_string()).ok(),
            _ => None,
        });
        for text in strings {
            if let Ok(path) = syn::parse_str::<syn::Path>(&text.value()) {
                self.visit_path(&path);
            }
        }
    }

    fn visit_visibility(&mut self, _: &'ast syn::Visibility) {}
}
