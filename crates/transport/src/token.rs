//! Tokens and their roles: parsing, and constant-time comparison. A token file has one `ROLE TOKEN`
//! per line; empty lines and lines that begin with `#` are skipped.

use std::fmt;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use sha2::{Digest, Sha256};
use subtle::{ConditionallySelectable, ConstantTimeEq};

use crate::private::exposed;

/// Shortest token, bytes. 128 random bits take 32 bytes in hex and 22 in base64; the limit also
/// rejects most passwords that people choose.
pub const MIN_TOKEN_BYTES: usize = 16;
/// Longest token, bytes.
pub const MAX_TOKEN_BYTES: usize = 256;
pub const MAX_TOKENS: usize = 256;
/// Largest token file, bytes.
pub const MAX_TOKEN_FILE_BYTES: u64 = 128 << 10;

/// Role of a caller, which determines the calls that it may make.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Leases jobs, reports outcomes, queries policies.
    Worker,
    /// Creates and controls campaigns, and reads everything.
    Operator,
    /// Reads campaigns, reports and results.
    Viewer,
}

impl Role {
    pub const ALL: [Role; 3] = [Role::Worker, Role::Operator, Role::Viewer];

    /// Name in a token file.
    pub fn name(self) -> &'static str {
        match self {
            Role::Worker => "worker",
            Role::Operator => "operator",
            Role::Viewer => "viewer",
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Role {
    type Err = ();

    fn from_str(text: &str) -> Result<Role, ()> {
        Role::ALL.into_iter().find(|role| role.name() == text).ok_or(())
    }
}

/// A secret token. Its `Debug` output is redacted, and it deliberately has no `PartialEq`.
#[derive(Clone)]
pub struct Token(String);

impl Token {
    /// Checks a token: visible ASCII without spaces, of a sensible length. The error never contains
    /// the token itself.
    pub fn parse(text: &str) -> Result<Token, &'static str> {
        if text.len() < MIN_TOKEN_BYTES {
            return Err("the token is too short to be a secret: take 32 random hex digits");
        }
        if text.len() > MAX_TOKEN_BYTES {
            return Err("the token is too long");
        }
        if !text.bytes().all(|byte| byte.is_ascii_graphic()) {
            return Err("the token holds something other than visible ASCII characters");
        }
        Ok(Token(text.to_owned()))
    }

    /// Returns the secret, for the header that carries it.
    pub(crate) fn secret(&self) -> &str {
        &self.0
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(…)")
    }
}

/// Tokens with their roles, in the order of their file.
#[derive(Clone, Debug)]
pub struct Tokens {
    tokens: Vec<(Role, Token)>,
    /// SHA-256 of each token. Digests have one length, so that comparing them reveals nothing
    /// about the length of a token.
    digests: Vec<[u8; 32]>,
}

/// Invalid tokens. The message follows "failed to …" and never contains a token.
#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    #[error("read token file {}", path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error(
        "read token file {}: its permissions, {mode:04o}, let other users access its tokens; \
         restrict them with `chmod {chmod} {}`",
        path.display(),
        path.display()
    )]
    Exposed { path: PathBuf, mode: u32, chmod: &'static str },
    #[error("read token file {}: it is larger than {MAX_TOKEN_FILE_BYTES} bytes", path.display())]
    TooLarge { path: PathBuf },
    #[error(
        "read line {line} of {place}: {problem}; write one `ROLE TOKEN` per line, the role being \
         worker, operator or viewer"
    )]
    Line {
        /// The file, or the environment variable.
        place: String,
        /// Number of the line, from 1.
        line: usize,
        problem: &'static str,
    },
    #[error("find a token in {place}: write one `ROLE TOKEN` per line")]
    Empty { place: String },
    #[error("read {place}: it holds more than {MAX_TOKENS} tokens")]
    TooMany { place: String },
}

impl Tokens {
    /// Reads a token file. Fails if other users can access the file.
    pub fn read(path: &Path) -> Result<Tokens, TokenError> {
        let read_error = |source| TokenError::Read { path: path.to_owned(), source };
        let mut bytes = Vec::new();
        let file = File::open(path).map_err(read_error)?;
        if let Some((mode, chmod)) = exposed(&file).map_err(read_error)? {
            return Err(TokenError::Exposed { path: path.to_owned(), mode, chmod });
        }
        let mut bounded = file.take(MAX_TOKEN_FILE_BYTES + 1);
        bounded.read_to_end(&mut bytes).map_err(read_error)?;
        if bytes.len() as u64 > MAX_TOKEN_FILE_BYTES {
            return Err(TokenError::TooLarge { path: path.to_owned() });
        }
        let text = String::from_utf8(bytes).map_err(|_| {
            read_error(io::Error::new(io::ErrorKind::InvalidData, "it is not UTF-8"))
        })?;
        Tokens::parse(&text, &format!("token file {}", path.display()))
    }

    /// Parses the text of a token file. `place` names its source in errors.
    pub fn parse(text: &str, place: &str) -> Result<Tokens, TokenError> {
        let mut tokens = Vec::new();
        for (index, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let entry = parse_line(line).map_err(|problem| TokenError::Line {
                place: place.to_owned(),
                line: index + 1,
                problem,
            })?;
            tokens.push(entry);
            if tokens.len() > MAX_TOKENS {
                let place = place.to_owned();
                return Err(TokenError::TooMany { place });
            }
        }
        if tokens.is_empty() {
            let place = place.to_owned();
            return Err(TokenError::Empty { place });
        }
        let digests = tokens.iter().map(|(_, token)| digest(token.secret()));
        Ok(Tokens { digests: digests.collect(), tokens })
    }

    /// Returns the role of the token `given`; `None` if it is unknown. The time taken does not
    /// depend on the token that matches, or on a match at all.
    pub fn role_of(&self, given: &str) -> Option<Role> {
        let given = digest(given);
        let mut matching = 0_u32;
        for (place, digest) in (1_u32..).zip(&self.digests) {
            matching.conditional_assign(&place, digest.ct_eq(&given));
        }
        let index = usize::try_from(matching).ok()?.checked_sub(1)?;
        self.tokens.get(index).map(|(role, _)| *role)
    }

    pub fn has(&self, role: Role) -> bool {
        self.tokens.iter().any(|(held, _)| *held == role)
    }

    /// Returns the first token of one of these roles, in the order of the roles.
    pub fn for_role(&self, wanted: &[Role]) -> Option<&Token> {
        wanted.iter().find_map(|wanted| {
            let found = self.tokens.iter().find(|(role, _)| role == wanted);
            found.map(|(_, token)| token)
        })
    }
}

fn parse_line(line: &str) -> Result<(Role, Token), &'static str> {
    let mut words = line.split_whitespace();
    let (Some(role), Some(token), None) = (words.next(), words.next(), words.next()) else {
        return Err("it is not two words");
    };
    let role = role.parse().map_err(|()| "its first word is not a role")?;
    Ok((role, Token::parse(token)?))
}

fn digest(secret: &str) -> [u8; 32] {
    Sha256::digest(secret.as_bytes()).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "# callers\n\nworker 0123456789abcdef0123\n  operator fedcba98765432100123  \r\nviewer vvvvvvvvvvvvvvvvvvvv\n";

    fn tokens() -> Tokens {
        Tokens::parse(FILE, "the test").expect("tokens")
    }

    #[test]
    fn a_known_token_has_a_role_and_any_other_text_has_none() {
        let tokens = tokens();
        let role = |given: &str| tokens.role_of(given);
        assert_eq!(role("0123456789abcdef0123"), Some(Role::Worker));
        assert_eq!(role("fedcba98765432100123"), Some(Role::Operator));
        assert_eq!(role("vvvvvvvvvvvvvvvvvvvv"), Some(Role::Viewer));
        for unknown in ["", "worker", "0123456789abcdef012", "0123456789abcdef01234"] {
            assert_eq!(role(unknown), None, "{unknown}");
        }
    }

    #[test]
    fn a_client_takes_the_token_of_the_first_role_that_it_can_use() {
        let tokens = tokens();
        let secret = |roles: &[Role]| tokens.for_role(roles).map(|token| token.secret());
        assert_eq!(secret(&[Role::Worker]), Some("0123456789abcdef0123"));
        let either = [Role::Operator, Role::Viewer];
        assert_eq!(secret(&either), Some("fedcba98765432100123"));
    }

    #[test]
    fn an_error_names_the_line_and_never_contains_a_token() {
        let check = |text: &str, words: &[&str]| {
            let error = Tokens::parse(text, "the test").expect_err(text).to_string();
            for word in words {
                assert!(error.contains(word), "{error}");
            }
            assert!(!error.contains("s3cret"), "{error}");
        };
        check("", &["the test", "ROLE TOKEN"]);
        check("# only this", &["find a token"]);
        check("worker s3cret", &["line 1", "too short"]);
        check("\nboss s3cret-s3cret-s3cret", &["line 2", "not a role"]);
        check("s3cret-s3cret-s3cret", &["two words"]);
        check("worker s3cret-s3cret s3cret-s3cret", &["two words"]);
        check("worker s3crét-s3cret-s3cret", &["visible ASCII"]);
        let long = format!("worker {}", "s3cret".repeat(100));
        check(&long, &["too long"]);
        let many = "viewer 0123456789abcdef\n".repeat(MAX_TOKENS + 1);
        check(&many, &["more than 256"]);
    }

    #[test]
    fn debug_output_of_tokens_is_redacted() {
        let printed = format!("{:?}", tokens().tokens);
        assert!(!printed.contains("0123456789"), "{printed}");
    }

    #[test]
    fn a_token_file_is_bounded_and_named_in_errors() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        let path = file.path();
        std::fs::write(path, FILE).expect("written");
        assert!(Tokens::read(path).is_ok());
        std::fs::write(path, vec![b'#'; 1 << 20]).expect("written");
        let error = Tokens::read(path).expect_err("too large").to_string();
        assert!(error.contains("larger than 131072 bytes"), "{error}");
        assert!(error.contains(&path.display().to_string()), "{error}");
        std::fs::write(path, [0xff, 0xfe]).expect("written");
        assert!(matches!(Tokens::read(path), Err(TokenError::Read { .. })));
    }
}
