//! Paths of a Rust source that begin in its own package: `crate::`, `super::`, `self::`. Test code is left out.

/// A token: a word, or a sign.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Token {
    Word(String),
    Sign(char),
}

/// What a source uses of its own package.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Source {
    /// Paths with `crate`, `super` or `self` in front; a `use` with braces gives one for each name.
    pub(crate) paths: Vec<Vec<String>>,
    /// Modules in files of their own that are compiled for tests only.
    pub(crate) test_modules: Vec<String>,
}

pub(crate) fn read(text: &str) -> Source {
    let tokens = tokens(text);
    let mut source = Source::default();
    let mut at = 0;
    while at < tokens.len() {
        if let Some(end) = attribute_cfg_test(&tokens, at) {
            at = skip_item(&tokens, end, &mut source.test_modules);
            continue;
        }
        let begins =
            matches!(&tokens[at], Token::Word(word) if matches!(word.as_str(), "crate" | "super" | "self"));
        let inside = at >= 1 && is_separator(&tokens, at.wrapping_sub(2));
        if begins && !inside && is_separator(&tokens, at + 1) {
            at = tree(&tokens, at, &[], &mut source.paths);
        } else {
            at += 1;
        }
    }
    source
}

/// Words of a source: identifiers, keywords and numbers; none of its comments and strings.
pub(crate) fn words(text: &str) -> Vec<String> {
    let word = |token| match token {
        Token::Word(word) => Some(word),
        Token::Sign(_) => None,
    };
    tokens(text).into_iter().filter_map(word).collect()
}

/// `::` at this place.
fn is_separator(tokens: &[Token], at: usize) -> bool {
    tokens.get(at) == Some(&Token::Sign(':')) && tokens.get(at.wrapping_add(1)) == Some(&Token::Sign(':'))
}

/// Reads a tree of paths from `at`; returns the place behind it.
fn tree(tokens: &[Token], mut at: usize, prefix: &[String], found: &mut Vec<Vec<String>>) -> usize {
    let mut path = prefix.to_vec();
    loop {
        match tokens.get(at) {
            Some(Token::Word(word)) => {
                path.push(word.clone());
                at += 1;
            }
            Some(Token::Sign('{')) => {
                at += 1;
                while let Some(token) = tokens.get(at) {
                    match token {
                        Token::Sign('}') => return at + 1,
                        Token::Word(word) if word == "as" => at += 2,
                        Token::Word(_) | Token::Sign('{') => at = tree(tokens, at, &path, found),
                        Token::Sign(_) => at += 1,
                    }
                }
                return at;
            }
            _ => break,
        }
        if !is_separator(tokens, at) || matches!(tokens.get(at + 2), Some(Token::Sign('<'))) {
            break;
        }
        at += 2;
    }
    found.push(path);
    at
}

/// The place behind `#[cfg(test)]`, if it stands here.
fn attribute_cfg_test(tokens: &[Token], at: usize) -> Option<usize> {
    let sign = |c| Token::Sign(c);
    let word = |w: &str| Token::Word(w.to_owned());
    let wanted = [sign('#'), sign('['), word("cfg"), sign('('), word("test"), sign(')'), sign(']')];
    (tokens.get(at..at + wanted.len())? == wanted).then_some(at + wanted.len())
}

/// The place behind the item here; a module without a body is noted.
fn skip_item(tokens: &[Token], mut at: usize, modules: &mut Vec<String>) -> usize {
    if let (Some(Token::Word(word)), Some(Token::Word(name)), Some(Token::Sign(';'))) =
        (tokens.get(at), tokens.get(at + 1), tokens.get(at + 2))
        && word == "mod"
    {
        modules.push(name.clone());
        return at + 3;
    }
    let mut depth = 0_i32;
    while let Some(token) = tokens.get(at) {
        at += 1;
        match token {
            Token::Sign('{' | '(' | '[') => depth += 1,
            Token::Sign('}') if depth == 1 => return at,
            Token::Sign('}' | ')' | ']') => depth -= 1,
            Token::Sign(';') if depth == 0 => return at,
            _ => {}
        }
    }
    at
}

/// Words and signs, without comments, strings and character literals.
fn tokens(text: &str) -> Vec<Token> {
    let chars: Vec<char> = text.chars().collect();
    let (mut found, mut at) = (Vec::new(), 0);
    let starts = |at: usize, what: &str| what.chars().enumerate().all(|(i, c)| chars.get(at + i) == Some(&c));
    while let Some(&c) = chars.get(at) {
        if starts(at, "//") {
            at += chars[at..].iter().take_while(|c| **c != '\n').count();
        } else if starts(at, "/*") {
            at += 2;
            while at < chars.len() && !starts(at, "*/") {
                at += 1;
            }
            at += 2;
        } else if let Some(end) = string_end(&chars, at) {
            at = end;
        } else if c.is_alphanumeric() || c == '_' {
            let word: String = chars[at..].iter().take_while(|c| c.is_alphanumeric() || **c == '_').collect();
            at += word.chars().count();
            found.push(Token::Word(word));
        } else {
            if !c.is_whitespace() {
                found.push(Token::Sign(c));
            }
            at += 1;
        }
    }
    found
}

/// The place behind the string or character literal that begins here; a lifetime is none.
fn string_end(chars: &[char], at: usize) -> Option<usize> {
    let boundary = at == 0 || !(chars[at - 1].is_alphanumeric() || chars[at - 1] == '_');
    let prefix = if boundary && matches!(chars[at], 'b' | 'c') { 1 } else { 0 };
    let raw = usize::from(boundary && chars.get(at + prefix) == Some(&'r'));
    let hashes =
        if raw == 1 { chars[at + prefix + 1..].iter().take_while(|c| **c == '#').count() } else { 0 };
    let open = at + prefix + raw + hashes;
    match chars.get(open)? {
        '"' if raw == 1 => {
            let mut end = open + 1;
            while end < chars.len() {
                let closed = chars[end] == '"'
                    && chars[end + 1..].iter().take(hashes).filter(|c| **c == '#').count() == hashes;
                if closed {
                    return Some(end + 1 + hashes);
                }
                end += 1;
            }
            Some(end)
        }
        '"' => Some(quoted_end(chars, open, '"')),
        '\'' if raw == 0 && (chars.get(open + 1) == Some(&'\\') || chars.get(open + 2) == Some(&'\'')) => {
            Some(quoted_end(chars, open, '\''))
        }
        _ => None,
    }
}

fn quoted_end(chars: &[char], open: usize, quote: char) -> usize {
    let mut end = open + 1;
    while let Some(c) = chars.get(end) {
        match c {
            '\\' => end += 2,
            c if *c == quote => return end + 1,
            _ => end += 1,
        }
    }
    end
}

#[test]
fn paths_of_uses_and_expressions_are_found_and_strings_comments_and_tests_are_not() {
    let text = r##"
        //! crate::comment::x
        use crate::a::{self, b::C, d as e};
        pub(crate) fn f<'a>(x: &'a str) -> super::g::H { crate::i::j::<u8>("crate::string", 'c', r#"crate::"raw"#) }
        use std::self_::x; /* super::block */ mod inner { use self::k; }
        #[cfg(test)]
        mod tests { use crate::in_test::X; fn g() { if true { } } }
        #[cfg(test)]
        mod far;
        #[cfg(test)]
        use crate::also_test;
        use crate::last;
    "##;
    let source = read(text);
    let paths: Vec<String> = source.paths.iter().map(|path| path.join("::")).collect();
    assert_eq!(
        paths,
        [
            "crate::a::self",
            "crate::a::b::C",
            "crate::a::d",
            "super::g::H",
            "crate::i::j",
            "self::k",
            "crate::last"
        ]
    );
    assert_eq!(source.test_modules, ["far"]);
}
