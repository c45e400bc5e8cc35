//! SROS2: the keys with which the node takes part among secured peers.
//!
//! An enclave is a folder `KEYSTORE/enclaves/NAME` with six files, as `ros2 security` and
//! `scripts/keystore.sh` lay them out. `ROS_SECURITY_ENABLE`, `_STRATEGY`, `_KEYSTORE` and
//! `_ENCLAVE_OVERRIDE` mean what they mean to rcl. Signatures, validity and permissions are checked
//! by DDS; what is missing, and what this DDS gets wrong, is found here first and said in words.

use std::path::{Path, PathBuf};

use super::env::EnvError;

#[cfg(all(test, feature = "security"))]
mod among_peers;

/// What an enclave consists of.
const FILES: [&str; 6] = [
    "identity_ca.cert.pem",
    "cert.pem",
    "key.pem",
    "permissions_ca.cert.pem",
    GOVERNANCE,
    "permissions.p7s",
];
const GOVERNANCE: &str = "governance.p7s";

/// Why the node cannot take part among secured peers.
#[derive(Debug, thiserror::Error)]
pub enum SecurityError {
    /// A variable says nothing that can be done.
    #[error(transparent)]
    Env(#[from] EnvError),
    /// A file or folder of the enclave cannot be read.
    #[error("ROS_SECURITY_STRATEGY is Enforce, and {} cannot be read: {source}", path.display())]
    Unreadable {
        /// Which file.
        path: PathBuf,
        /// The system's words.
        source: std::io::Error,
    },
    /// The governance asks for what RustDDS 0.15.1 writes so that it cannot be read back.
    #[error(
        "{}: data_protection_kind is {kind}, with which this node's DDS can read hardly any message. \
         Set it to NONE and metadata_protection_kind to ENCRYPT, which encrypts the data as well, and \
         sign the governance anew (docs/topics.md)",
        path.display()
    )]
    PayloadProtection {
        /// The governance.
        path: PathBuf,
        /// What it asks for.
        kind: String,
    },
    /// The program was built without the feature `security`.
    #[error(
        "ROS_SECURITY_ENABLE asks for {}, but this build has no security: build with `--features security`",
        folder.display()
    )]
    NotBuilt {
        /// The enclave.
        folder: PathBuf,
    },
}

/// The keys of one enclave, all of whose files can be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Security {
    enclave_folder: PathBuf,
}

/// What the variables ask for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Asked {
    /// No security.
    Nothing,
    /// Security where its keys are there, which they are not: the node goes on without. In words.
    Missing(String),
    /// Security, with these keys.
    Keys(Security),
}

impl Security {
    /// Reads the variables through `get`, and looks whether the enclave's files can be read;
    /// `enclave` is the one that the command line names.
    ///
    /// # Errors
    /// [`SecurityError`] where it is asked for and cannot be had.
    pub fn from_variables(
        get: impl Fn(&str) -> Option<String>,
        enclave: Option<&str>,
    ) -> Result<Asked, SecurityError> {
        let set = |name: &str| get(name).filter(|value| !value.trim().is_empty());
        // As rcl has it: this word alone.
        if set("ROS_SECURITY_ENABLE").as_deref() != Some("true") {
            return Ok(Asked::Nothing);
        }
        let is_enforced = set("ROS_SECURITY_STRATEGY").as_deref() == Some("Enforce");
        let Some(keystore) = set("ROS_SECURITY_KEYSTORE") else {
            return Err(SecurityError::Env(EnvError {
                variable: "ROS_SECURITY_KEYSTORE",
                value: String::new(),
                reason: "must name the keystore when ROS_SECURITY_ENABLE is true",
            }));
        };
        let named = set("ROS_SECURITY_ENCLAVE_OVERRIDE");
        let variable = match named {
            Some(_) => "ROS_SECURITY_ENCLAVE_OVERRIDE",
            None => "--enclave",
        };
        let enclave = named.as_deref().or(enclave).unwrap_or("/");
        let parts: Vec<&str> = enclave.split('/').filter(|part| !part.is_empty()).collect();
        if parts.contains(&"..") {
            return Err(SecurityError::Env(EnvError {
                variable,
                value: enclave.to_owned(),
                reason: "leads out of the keystore",
            }));
        }
        let mut enclave_folder = PathBuf::from(keystore).join("enclaves");
        enclave_folder.extend(parts);
        let governance = match readable(&enclave_folder) {
            Ok(governance) => governance,
            Err(error) if is_enforced => return Err(error),
            Err(SecurityError::Unreadable { path, source }) => {
                return Ok(Asked::Missing(format!(
                    "ROS_SECURITY_ENABLE is true, but {} cannot be read ({source}): the node goes on \
                     WITHOUT security, as ROS_SECURITY_STRATEGY is not Enforce",
                    path.display()
                )));
            }
            Err(error) => return Err(error),
        };
        if let Some(kind) = payload_protection(&governance) {
            return Err(SecurityError::PayloadProtection {
                path: enclave_folder.join(GOVERNANCE),
                kind,
            });
        }
        Ok(Asked::Keys(Self { enclave_folder }))
    }

    /// From this process' environment.
    ///
    /// # Errors
    /// As [`Self::from_variables`].
    #[expect(
        clippy::disallowed_methods,
        reason = "these settings are ROS's own and come by the environment"
    )]
    pub fn from_process(enclave: Option<&str>) -> Result<Asked, SecurityError> {
        Self::from_variables(|name| std::env::var(name).ok(), enclave)
    }

    /// The folder with the enclave's keys, certificates and permissions.
    pub fn enclave_folder(&self) -> &Path {
        &self.enclave_folder
    }
}

/// The governance of an enclave all of whose files can be read.
fn readable(enclave_folder: &Path) -> Result<String, SecurityError> {
    let mut governance = String::new();
    for file in FILES {
        let path = enclave_folder.join(file);
        match std::fs::read(&path) {
            Ok(bytes) if file == GOVERNANCE => {
                governance = String::from_utf8_lossy(&bytes).into_owned();
            }
            Ok(_) => {}
            Err(source) => return Err(SecurityError::Unreadable { path, source }),
        }
    }
    Ok(governance)
}

/// What a governance asks for beyond `NONE` for the payload of any topic. The document is signed in
/// the clear. RustDDS 0.15.1 pads an encrypted payload to four bytes (`messages/submessages/data.rs`)
/// and looks for its footer at the padded end (`crypto_transform.rs`), so that only messages whose
/// length is a multiple of four can be read.
fn payload_protection(governance: &str) -> Option<String> {
    const TAG: &str = "<data_protection_kind>";
    let kinds = governance.split(TAG).skip(1);
    let mut kinds = kinds.map(|rest| rest.split('<').next().unwrap_or("").trim());
    kinds.find(|kind| *kind != "NONE").map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ENABLE: (&str, &str) = ("ROS_SECURITY_ENABLE", "true");
    const ENFORCE: (&str, &str) = ("ROS_SECURITY_STRATEGY", "Enforce");

    fn asked(pairs: &[(&str, &str)], enclave: Option<&str>) -> Result<Asked, SecurityError> {
        let get = |name: &str| {
            let found = pairs.iter().find(|(n, _)| *n == name);
            found.map(|(_, value)| (*value).to_owned())
        };
        Security::from_variables(get, enclave)
    }

    /// A keystore with one enclave, `/robot/veneer`, and its folder.
    fn keystore(governance: &str) -> (tempfile::TempDir, PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("enclaves/robot/veneer");
        std::fs::create_dir_all(&folder).unwrap();
        for file in FILES {
            std::fs::write(folder.join(file), "").unwrap();
        }
        std::fs::write(folder.join(GOVERNANCE), governance).unwrap();
        (dir, folder)
    }

    #[test]
    fn keys_are_looked_for_where_rcl_looks() {
        let (dir, folder) = keystore("");
        let store = ("ROS_SECURITY_KEYSTORE", dir.path().to_str().unwrap());
        let keys = Asked::Keys(Security {
            enclave_folder: folder,
        });
        assert_eq!(asked(&[store, ENFORCE], None).unwrap(), Asked::Nothing);
        let other_word = ("ROS_SECURITY_ENABLE", "1");
        assert_eq!(asked(&[store, other_word], None).unwrap(), Asked::Nothing);
        assert!(asked(&[ENABLE], None).is_err());
        let name = Some("/robot/veneer");
        assert_eq!(asked(&[ENABLE, store], name).unwrap(), keys);
        let override_ = ("ROS_SECURITY_ENCLAVE_OVERRIDE", "/robot/veneer");
        assert_eq!(
            asked(&[ENABLE, store, override_], Some("/x")).unwrap(),
            keys
        );
        assert!(asked(&[ENABLE, store], Some("/../../x")).is_err());
    }

    #[test]
    fn a_missing_file_is_named_and_enforce_refuses_to_go_on() {
        let (dir, folder) = keystore("");
        let store = ("ROS_SECURITY_KEYSTORE", dir.path().to_str().unwrap());
        let name = Some("/robot/veneer");
        for file in FILES {
            let path = folder.join(file);
            std::fs::rename(&path, folder.join("aside")).unwrap();
            let words = path.display().to_string();
            let refused = asked(&[ENABLE, store, ENFORCE], name).unwrap_err();
            assert!(refused.to_string().contains(&words), "{refused}");
            // Without Enforce the node goes on, and says so.
            match asked(&[ENABLE, store], name).unwrap() {
                Asked::Missing(said) => assert!(said.contains(&words), "{said}"),
                other => panic!("{file}: {other:?}"),
            }
            std::fs::rename(folder.join("aside"), &path).unwrap();
        }
    }

    #[test]
    fn what_dds_gets_wrong_is_refused_under_any_strategy() {
        let rule = |kind: &str| format!("<data_protection_kind> {kind} </data_protection_kind>");
        for (governance, refused) in [
            (rule("NONE"), None),
            (rule("ENCRYPT"), Some("ENCRYPT")),
            (rule("NONE") + &rule("SIGN"), Some("SIGN")),
        ] {
            let (dir, _) = keystore(&governance);
            let store = ("ROS_SECURITY_KEYSTORE", dir.path().to_str().unwrap());
            let found = asked(&[ENABLE, store], Some("/robot/veneer"));
            match refused {
                None => assert!(matches!(found, Ok(Asked::Keys(_))), "{found:?}"),
                Some(kind) => {
                    let words = found.unwrap_err().to_string();
                    assert!(
                        words.contains(kind) && words.contains(GOVERNANCE),
                        "{words}"
                    );
                }
            }
        }
    }
}
