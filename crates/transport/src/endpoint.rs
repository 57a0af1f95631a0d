//! URLs of gRPC servers: `grpc://HOST:PORT` and `http://HOST:PORT` mean the same,
//! and so do `grpcs://` and `https://`.

use tonic::transport::Endpoint;

/// Invalid URL of a server. The message follows "failed to …".
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("read {given:?} as a server's address: {}", EndpointError::REMEDY)]
pub struct EndpointError {
    pub given: String,
}

impl EndpointError {
    /// Form of a valid address, as the remedy in messages.
    pub const REMEDY: &str = "write http://HOST:PORT or grpc://HOST:PORT, and for a server over \
                              TLS https:// or grpcs://";
}

pub fn parse_endpoint(url: &str) -> Result<Endpoint, EndpointError> {
    // A user and a password are refused and not quoted, since addresses are shown and logged.
    let (user, shown) = url.rsplit_once('@').map_or((None, url), |(user, host)| (Some(user), host));
    let error = || EndpointError { given: shown.to_owned() };
    let (scheme, authority) = match url.split_once("://") {
        Some(("http" | "grpc", authority)) => ("http", authority),
        Some(("https" | "grpcs", authority)) => ("https", authority),
        _ => return Err(error()),
    };
    let authority = authority.trim_end_matches('/');
    let endpoint = Endpoint::from_shared(format!("{scheme}://{authority}")).map_err(|_| error())?;
    let has_host = endpoint.uri().host().is_some_and(|host| !host.is_empty());
    let has_no_path = matches!(endpoint.uri().path(), "" | "/") && endpoint.uri().query().is_none();
    (user.is_none() && has_host && has_no_path).then_some(endpoint).ok_or_else(error)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_schemes_name_the_same_server() {
        for url in [
            "grpc://gpu-3:7100",
            "http://gpu-3:7100",
            "http://gpu-3:7100/",
            "grpcs://gpu-3:7100",
            "https://gpu-3:7100",
        ] {
            let endpoint = parse_endpoint(url).expect(url);
            assert_eq!(
                endpoint.uri().authority().map(|authority| authority.as_str()),
                Some("gpu-3:7100")
            );
        }
    }

    #[test]
    fn an_invalid_server_url_is_refused_with_an_example() {
        for url in [
            "",
            "localhost:7000",
            "ftp://host",
            "http://",
            "http://a b",
            "http://h/path",
            "http://me:secret@h:1",
        ] {
            let error = parse_endpoint(url).expect_err(url).to_string();
            assert!(error.contains("http://HOST:PORT") && !error.contains("secret"), "{error}");
        }
    }
}
