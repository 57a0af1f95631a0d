//! A certificate authority, whose files only this user may read. Shared with other packages' tests.

use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, IsCa, KeyPair, date_time_ymd};
use tempfile::TempDir;

/// Writes a file that only this user may read.
pub(crate) fn write_private(path: &Path, text: &str) {
    std::fs::write(path, text).expect("written");
    std::fs::set_permissions(path, Permissions::from_mode(0o600)).expect("set");
}

/// A certificate authority in a folder, which signs certificates for `localhost`.
pub(crate) struct Authority {
    folder: TempDir,
    issuer: CertifiedIssuer<'static, KeyPair>,
}

impl Authority {
    pub(crate) fn new() -> Authority {
        let mut params = CertificateParams::new(Vec::new()).expect("no names");
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let key = KeyPair::generate().expect("a key");
        let authority = Authority {
            folder: tempfile::tempdir().expect("a temporary folder"),
            issuer: CertifiedIssuer::self_signed(params, key).expect("signed"),
        };
        write_private(&authority.path("ca.pem"), &authority.issuer.pem());
        authority
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Signs a certificate that is valid until the end of a year; returns it as server arguments.
    pub(crate) fn sign(&self, until_year: i32) -> [String; 4] {
        let mut params = CertificateParams::new(["localhost".to_owned()]).expect("a name");
        params.not_after = date_time_ymd(until_year, 12, 31);
        let key = KeyPair::generate().expect("a key");
        let certificate = params.signed_by(&key, &self.issuer).expect("signed");
        let paths = [self.path("cert.pem"), self.path("key.pem")];
        write_private(&paths[0], &certificate.pem());
        write_private(&paths[1], &key.serialize_pem());
        let [certificate, key] = paths.map(|path| path.display().to_string());
        ["--tls-cert".into(), certificate, "--tls-key".into(), key]
    }
}
