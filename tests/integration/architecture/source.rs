//! What the code of each file names, outside tests: paths, macros, methods, literals and `async`.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use proc_macro2::{Delimiter, TokenStream, TokenTree};
use syn::parse::Parser;
use syn::punctuated::Punctuated;
use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::{Attribute, Block, Expr, Item, Meta, Token};

/// Texts of source files by their path under `src`, with `/` between folders.
pub type Sources = BTreeMap<String, String>;

/// A file that is compiled into the program, and what stands in it.
#[derive(Debug)]
pub struct Code {
    /// Path under `src`.
    pub file: String,
    /// Modules that it lies in, such as `["store", "open"]`; empty for `lib.rs` and `main.rs`.
    pub module: Vec<String>,
    /// First sentence of its `//!`, without the full stop; empty where there is none.
    pub about: String,
    pub mentions: Vec<Mention>,
}

impl Code {
    /// The room that the file is or lies in; `main.rs` is one, and so is `lib.rs`, which names all others.
    pub fn room(&self) -> &str {
        self.module.first().map_or(self.file.trim_end_matches(".rs"), String::as_str)
    }
}

/// Something named at a line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mention {
    pub line: usize,
    pub what: What,
    /// Whether the code needs what it names. `pub use` only hands a name on, and `pub(super)` only says who
    /// may see an item.
    pub needed: bool,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum What {
    /// A path with its imports resolved: it begins with `crate`, a crate's name, or a name of the file. The last
    /// segment `*` stands for everything below.
    Path(Vec<String>),
    Macro(String),
    Method(String),
    Async,
    /// Text of a string literal that is no documentation.
    Literal(String),
    /// `#[allow(..)]`.
    Allowed,
}

/// Every file that `lib.rs` and `main.rs` lead to outside tests; or what keeps a file from being read.
pub fn program(sources: &Sources) -> Result<Vec<Code>, Vec<String>> {
    let mut walk = Walk { sources, reached: Vec::new(), codes: Vec::new(), problems: Vec::new() };
    for root in ["lib.rs", "main.rs"] {
        if sources.contains_key(root) {
            walk.file(root.to_owned(), Vec::new(), false);
        }
    }
    for file in sources.keys().filter(|file| !walk.reached.contains(file)) {
        walk.problems.push(format!("{file} is declared by no `mod`"));
    }
    if walk.problems.is_empty() { Ok(walk.codes) } else { Err(walk.problems) }
}

/// Follows `mod name;` from file to file.
struct Walk<'a> {
    sources: &'a Sources,
    reached: Vec<String>,
    codes: Vec<Code>,
    problems: Vec<String>,
}

impl Walk<'_> {
    fn file(&mut self, file: String, module: Vec<String>, for_tests: bool) {
        let parsed = match syn::parse_file(&self.sources[&file]) {
            Ok(parsed) => parsed,
            Err(error) => {
                self.problems.push(format!("{file}:{}: {error}", error.span().start().line));
                return;
            }
        };
        let for_tests = for_tests || only_for_tests(&parsed.attrs);
        self.reached.push(file.clone());
        self.declared(&file, &parsed.items, &module, for_tests);
        if for_tests {
            return;
        }
        let mut finder = Finder {
            module: module.clone(),
            children: BTreeMap::new(),
            imports: HashMap::new(),
            mentions: Vec::new(),
            needed: true,
        };
        finder.children_of(&parsed.items, &module);
        finder.visit_file(&parsed);
        let mentions = finder.resolved();
        self.codes.push(Code { file, module, about: about(&parsed.attrs), mentions });
    }

    /// Reads the files of the modules that items declare, also within modules that stand in the file.
    fn declared(&mut self, file: &str, items: &[Item], module: &[String], for_tests: bool) {
        for item in items {
            let Item::Mod(declared) = item else { continue };
            let inside = [module, &[declared.ident.to_string()]].concat();
            let for_tests = for_tests || only_for_tests(&declared.attrs);
            if let Some((_, items)) = &declared.content {
                self.declared(file, items, &inside, for_tests);
                continue;
            }
            let stem = inside.join("/");
            let path = declared.attrs.iter().find_map(|attribute| text_of(attribute, "path"));
            let beside = path.map(|name| match file.rsplit_once('/') {
                Some((folder, _)) => format!("{folder}/{name}"),
                None => name,
            });
            let candidates = beside.into_iter().chain([format!("{stem}.rs"), format!("{stem}/mod.rs")]);
            match candidates.into_iter().find(|name| self.sources.contains_key(name)) {
                Some(found) => self.file(found, inside, for_tests),
                None => self.problems.push(format!("{file}: no file for `mod {}`", declared.ident)),
            }
        }
    }
}

/// The text of an attribute `#[name = "text"]`.
fn text_of(attribute: &Attribute, name: &str) -> Option<String> {
    let Meta::NameValue(pair) = &attribute.meta else { return None };
    let Expr::Lit(literal) = &pair.value else { return None };
    let syn::Lit::Str(text) = &literal.lit else { return None };
    attribute.path().is_ident(name).then(|| text.value())
}

/// The first sentence of a file's documentation, without its full stop.
fn about(attributes: &[Attribute]) -> String {
    let lines = attributes.iter().filter_map(|attribute| text_of(attribute, "doc"));
    let lines = lines.map(|line| line.trim().to_owned()).take_while(|line| !line.is_empty());
    let paragraph = lines.collect::<Vec<_>>().join(" ");
    paragraph.split(". ").next().unwrap_or_default().trim_end_matches('.').to_owned()
}

/// Whether what has these attributes is compiled for tests only: a `cfg` that nothing but a test fulfils, or a
/// test function.
fn only_for_tests(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        let is_test = attribute.path().segments.last().is_some_and(|last| last.ident == "test");
        let condition = || attribute.parse_args::<Meta>().is_ok_and(|condition| needs_test(&condition));
        is_test || (attribute.path().is_ident("cfg") && condition())
    })
}

fn needs_test(condition: &Meta) -> bool {
    let inner = |list: &syn::MetaList| {
        list.parse_args_with(Punctuated::<Meta, Token![,]>::parse_terminated).unwrap_or_default()
    };
    match condition {
        Meta::Path(path) => path.is_ident("test"),
        Meta::List(list) if list.path.is_ident("all") => inner(list).iter().any(needs_test),
        Meta::List(list) if list.path.is_ident("any") => {
            let parts = inner(list);
            !parts.is_empty() && parts.iter().all(needs_test)
        }
        Meta::List(_) | Meta::NameValue(_) => false,
    }
}

struct Finder {
    /// Module that the code at hand lies in.
    module: Vec<String>,
    /// Modules that each module declares.
    children: BTreeMap<Vec<String>, BTreeSet<String>>,
    /// Full paths by the names under which `use` brings them in, by module: a module sees no others.
    imports: HashMap<Vec<String>, HashMap<String, Vec<String>>>,
    /// With the module of each, in which its path is to be resolved.
    mentions: Vec<(Vec<String>, Mention)>,
    /// Whether what is named now is needed, see [`Mention::needed`].
    needed: bool,
}

impl Finder {
    /// Notes the modules that items of a module declare, before any path is read: a path may stand before
    /// `mod`.
    fn children_of(&mut self, items: &[Item], module: &[String]) {
        for item in items {
            let Item::Mod(declared) = item else { continue };
            if only_for_tests(&declared.attrs) {
                continue;
            }
            let name = declared.ident.to_string();
            if let Some((_, items)) = &declared.content {
                self.children_of(items, &[module, std::slice::from_ref(&name)].concat());
            }
            self.children.entry(module.to_vec()).or_default().insert(name);
        }
    }

    fn note(&mut self, line: usize, what: What) {
        self.mentions.push((self.module.clone(), Mention { line, what, needed: self.needed }));
    }

    fn path(&mut self, line: usize, segments: Vec<String>) {
        let absolute = self.absolute(segments);
        self.note(line, What::Path(absolute));
    }

    /// The path with `self`, `super` and modules of this module resolved. A single name may be a variable
    /// that is called like a module, and stays.
    fn absolute(&self, mut segments: Vec<String>) -> Vec<String> {
        let mut module = self.module.clone();
        let first = segments.first().map(String::as_str);
        match first {
            Some("armwatch") => segments[0] = "crate".to_owned(),
            Some("self" | "super") => {
                while let Some("self" | "super") = segments.first().map(String::as_str) {
                    if segments.remove(0) == "super" {
                        module.pop();
                    }
                }
                module.insert(0, "crate".to_owned());
                module.extend(segments);
                return module;
            }
            Some(first) if segments.len() > 1 && self.declares(first) => {
                module.insert(0, "crate".to_owned());
                module.extend(segments);
                return module;
            }
            _ => {}
        }
        segments
    }

    fn declares(&self, name: &str) -> bool {
        self.children.get(&self.module).is_some_and(|children| children.contains(name))
    }

    fn use_tree(&mut self, tree: &syn::UseTree, before: &[String]) {
        match tree {
            syn::UseTree::Path(path) => {
                let longer = [before, &[path.ident.to_string()]].concat();
                self.use_tree(&path.tree, &longer);
            }
            syn::UseTree::Group(group) => {
                for tree in &group.items {
                    self.use_tree(tree, before);
                }
            }
            syn::UseTree::Name(name) => self.import(&name.ident, &name.ident, before),
            syn::UseTree::Rename(rename) => self.import(&rename.ident, &rename.rename, before),
            syn::UseTree::Glob(star) => {
                let all = [before, &["*".to_owned()]].concat();
                self.path(star.span().start().line, all);
            }
        }
    }

    fn import(&mut self, name: &syn::Ident, known_as: &syn::Ident, before: &[String]) {
        let (line, mut full) = (name.span().start().line, before.to_vec());
        // `use a::b::{self}` is `use a::b`
        let known_as = if name == "self" && known_as == "self" {
            before.last().cloned().unwrap_or_default()
        } else {
            known_as.to_string()
        };
        if name != "self" || before.is_empty() {
            full.push(name.to_string());
        }
        let mut full = self.absolute(full);
        self.imports.entry(self.module.clone()).or_default().insert(known_as, full.clone());
        // a single name counts where it is imported, and is nobody's elsewhere
        if full.len() == 1 {
            full.push("self".to_owned());
        }
        self.note(line, What::Path(full));
    }

    /// What was found, with names replaced by what `use` says they are.
    fn resolved(self) -> Vec<Mention> {
        let Self { imports, mentions, .. } = self;
        let full = |module: &Vec<String>, path: Vec<String>| {
            let known = path.first().and_then(|first| imports.get(module)?.get(first));
            match known {
                Some(import) => [import, &path[1..]].concat(),
                None => path,
            }
        };
        let mention = |(module, mention): (Vec<String>, Mention)| match mention.what {
            // twice: a name may come from another one, as in `use std::time; use time::Instant;`
            What::Path(path) => {
                let path = full(&module, full(&module, path));
                Mention { what: What::Path(path), ..mention }
            }
            _ => mention,
        };
        let names_more_than_itself = |mention: &Mention| !matches!(&mention.what, What::Path(path) if path.len() == 1 && path[0] != "crate");
        mentions.into_iter().map(mention).filter(names_more_than_itself).collect()
    }

    /// Code in a macro's parentheses: statements or arguments where it can be parsed, names otherwise.
    fn tokens(&mut self, tokens: &TokenStream) {
        if let Ok(statements) = Block::parse_within.parse2(tokens.clone()) {
            for statement in &statements {
                self.visit_stmt(statement);
            }
        } else if let Ok(arguments) = Punctuated::<Expr, Token![,]>::parse_terminated.parse2(tokens.clone()) {
            for argument in &arguments {
                self.visit_expr(argument);
            }
        } else {
            self.scan(tokens);
        }
    }

    /// Names in tokens of which no more is known than their order.
    fn scan(&mut self, tokens: &TokenStream) {
        let trees: Vec<TokenTree> = tokens.clone().into_iter().collect();
        let is = |at: usize, sign: char| matches!(trees.get(at), Some(TokenTree::Punct(punct)) if punct.as_char() == sign);
        let opens = |at: usize| matches!(trees.get(at), Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Parenthesis);
        let mut at = 0;
        while at < trees.len() {
            let line = trees[at].span().start().line;
            match &trees[at] {
                TokenTree::Group(group) => self.tokens(&group.stream()),
                TokenTree::Literal(literal) => {
                    if let Ok(text) = syn::parse2::<syn::LitStr>(TokenTree::from(literal.clone()).into()) {
                        self.note(line, What::Literal(text.value()));
                    }
                }
                TokenTree::Ident(ident) if at > 0 && is(at - 1, '.') => {
                    match ident.to_string().as_str() {
                        "await" => self.note(line, What::Async),
                        name if opens(at + 1) => self.note(line, What::Method(name.to_owned())),
                        _ => {}
                    };
                }
                TokenTree::Ident(ident) if ident == "async" => self.note(line, What::Async),
                TokenTree::Ident(ident) => {
                    let mut segments = vec![ident.to_string()];
                    while is(at + 1, ':') && is(at + 2, ':') {
                        match trees.get(at + 3) {
                            Some(TokenTree::Ident(next)) => segments.push(next.to_string()),
                            Some(TokenTree::Group(group)) => {
                                self.scan_group(line, &segments, &group.stream());
                                break;
                            }
                            Some(TokenTree::Punct(star)) if star.as_char() == '*' => {
                                segments.push("*".to_owned());
                            }
                            _ => break,
                        }
                        at += 3;
                    }
                    if is(at + 1, '!') && !is(at + 2, '=') {
                        self.note(line, What::Macro(segments[segments.len() - 1].clone()));
                    }
                    self.path(line, segments);
                }
                TokenTree::Punct(_) => {}
            }
            at += 1;
        }
    }

    /// `{a, b::c}` after a path.
    fn scan_group(&mut self, line: usize, before: &[String], group: &TokenStream) {
        let trees = Punctuated::<syn::UseTree, Token![,]>::parse_terminated.parse2(group.clone());
        match trees {
            Ok(trees) => trees.iter().for_each(|tree| self.use_tree(tree, before)),
            Err(_) => self.path(line, [before, &["*".to_owned()]].concat()),
        }
    }
}

/// Visits what is not for tests.
macro_rules! unless_for_tests {
    ($($visit:ident: $node:ty),* $(,)?) => {
        $(fn $visit(&mut self, node: &'ast $node) {
            if !only_for_tests(&node.attrs) {
                visit::$visit(self, node);
            }
        })*
    };
}

impl<'ast> Visit<'ast> for Finder {
    unless_for_tests! {
        visit_item_const: syn::ItemConst,
        visit_item_enum: syn::ItemEnum,
        visit_item_fn: syn::ItemFn,
        visit_item_foreign_mod: syn::ItemForeignMod,
        visit_item_impl: syn::ItemImpl,
        visit_item_macro: syn::ItemMacro,
        visit_item_static: syn::ItemStatic,
        visit_item_struct: syn::ItemStruct,
        visit_item_trait: syn::ItemTrait,
        visit_item_trait_alias: syn::ItemTraitAlias,
        visit_item_type: syn::ItemType,
        visit_item_union: syn::ItemUnion,
        visit_impl_item_const: syn::ImplItemConst,
        visit_impl_item_fn: syn::ImplItemFn,
        visit_impl_item_macro: syn::ImplItemMacro,
        visit_impl_item_type: syn::ImplItemType,
        visit_trait_item_const: syn::TraitItemConst,
        visit_trait_item_fn: syn::TraitItemFn,
        visit_trait_item_macro: syn::TraitItemMacro,
        visit_trait_item_type: syn::TraitItemType,
        visit_arm: syn::Arm,
        visit_expr_block: syn::ExprBlock,
        visit_field: syn::Field,
        visit_field_value: syn::FieldValue,
        visit_local: syn::Local,
        visit_stmt_macro: syn::StmtMacro,
        visit_variant: syn::Variant,
    }

    fn visit_item_mod(&mut self, node: &'ast syn::ItemMod) {
        if !only_for_tests(&node.attrs) {
            self.module.push(node.ident.to_string());
            visit::visit_item_mod(self, node);
            self.module.pop();
        }
    }

    fn visit_item_use(&mut self, node: &'ast syn::ItemUse) {
        if !only_for_tests(&node.attrs) {
            self.needed = matches!(node.vis, syn::Visibility::Inherited);
            self.use_tree(&node.tree, &[]);
            self.needed = true;
        }
    }

    fn visit_vis_restricted(&mut self, node: &'ast syn::VisRestricted) {
        self.needed = false;
        visit::visit_vis_restricted(self, node);
        self.needed = true;
    }

    fn visit_item_extern_crate(&mut self, node: &'ast syn::ItemExternCrate) {
        if !only_for_tests(&node.attrs) {
            let known_as = node.rename.as_ref().map_or(&node.ident, |(_, name)| name);
            self.import(&node.ident, known_as, &[]);
        }
    }

    fn visit_path(&mut self, node: &'ast syn::Path) {
        let segments = node.segments.iter().map(|segment| segment.ident.to_string()).collect();
        self.path(node.span().start().line, segments);
        visit::visit_path(self, node);
    }

    fn visit_macro(&mut self, node: &'ast syn::Macro) {
        if let Some(last) = node.path.segments.last() {
            self.note(node.span().start().line, What::Macro(last.ident.to_string()));
        }
        self.visit_path(&node.path);
        self.tokens(&node.tokens);
    }

    fn visit_attribute(&mut self, node: &'ast Attribute) {
        let line = node.span().start().line;
        if node.path().is_ident("doc") {
            return;
        }
        if node.path().is_ident("allow") {
            self.note(line, What::Allowed);
        }
        self.visit_path(node.path());
        if let Meta::List(list) = &node.meta {
            self.scan(&list.tokens);
        }
    }

    fn visit_expr_method_call(&mut self, node: &'ast syn::ExprMethodCall) {
        // whether standard error is a terminal may be asked everywhere
        if node.method == "is_terminal" && matches!(&*node.receiver, Expr::Call(call) if call.args.is_empty())
        {
            return;
        }
        self.note(node.method.span().start().line, What::Method(node.method.to_string()));
        visit::visit_expr_method_call(self, node);
    }

    fn visit_signature(&mut self, node: &'ast syn::Signature) {
        if let Some(word) = &node.asyncness {
            self.note(word.span().start().line, What::Async);
        }
        visit::visit_signature(self, node);
    }

    fn visit_expr_closure(&mut self, node: &'ast syn::ExprClosure) {
        if let Some(word) = &node.asyncness {
            self.note(word.span().start().line, What::Async);
        }
        visit::visit_expr_closure(self, node);
    }

    fn visit_expr_async(&mut self, node: &'ast syn::ExprAsync) {
        self.note(node.async_token.span().start().line, What::Async);
        visit::visit_expr_async(self, node);
    }

    fn visit_expr_await(&mut self, node: &'ast syn::ExprAwait) {
        self.note(node.await_token.span().start().line, What::Async);
        visit::visit_expr_await(self, node);
    }

    fn visit_lit_str(&mut self, node: &'ast syn::LitStr) {
        self.note(node.span().start().line, What::Literal(node.value()));
    }
}
