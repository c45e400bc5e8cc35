//! The environment variables that decide whom a ROS 2 node can hear.
//!
//! `ROS_DOMAIN_ID`; `ROS_AUTOMATIC_DISCOVERY_RANGE` (`LOCALHOST`, `SUBNET`, `OFF`,
//! `SYSTEM_DEFAULT`) with `ROS_STATIC_PEERS`; the older `ROS_LOCALHOST_ONLY`, which wins where it
//! is set, as in rmw. What this node's DDS cannot do is told, not passed over: [`Network::notes`].

use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};

/// Largest domain whose ports all lie below 65536.
const MAX_DOMAIN: u16 = 232;

/// Why the environment was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{variable}='{value}' {reason}")]
pub struct EnvError {
    /// Which variable.
    pub variable: &'static str,
    /// Its value.
    pub value: String,
    /// What is wrong with it.
    pub reason: &'static str,
}

/// Whom the node can hear.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct Network {
    /// The DDS domain.
    pub domain_id: u16,
    /// The only interfaces in use; empty takes all.
    pub interfaces: Vec<Ipv4Addr>,
    /// What was asked for and cannot be had, with the remedy, in words.
    pub notes: Vec<String>,
}

impl Network {
    /// Reads the variables through `get`.
    ///
    /// # Errors
    /// [`EnvError`] for a value that says nothing that can be done.
    pub fn from_variables(get: impl Fn(&str) -> Option<String>) -> Result<Self, EnvError> {
        let set = |name: &str| get(name).filter(|value| !value.trim().is_empty());
        let mut network = Self {
            domain_id: match set("ROS_DOMAIN_ID") {
                None => 0,
                Some(value) => domain_id(&value)?,
            },
            ..Self::default()
        };
        let localhost_only = match set("ROS_LOCALHOST_ONLY").as_deref().map(str::trim) {
            None | Some("0") => false,
            Some("1") => true,
            Some(other) => return Err(refused("ROS_LOCALHOST_ONLY", other, "is neither 0 nor 1")),
        };
        let range = set("ROS_AUTOMATIC_DISCOVERY_RANGE").unwrap_or_default();
        let is_local = match range.trim().to_ascii_uppercase().as_str() {
            "" | "SUBNET" | "SYSTEM_DEFAULT" => false,
            "LOCALHOST" => true,
            "OFF" => {
                return Err(refused(
                    "ROS_AUTOMATIC_DISCOVERY_RANGE",
                    &range,
                    "leaves no way to find a peer, as this node's DDS has no static peers: use LOCALHOST or SUBNET",
                ));
            }
            _ => {
                return Err(refused(
                    "ROS_AUTOMATIC_DISCOVERY_RANGE",
                    &range,
                    "is none of LOCALHOST, SUBNET, OFF, SYSTEM_DEFAULT",
                ));
            }
        };
        let is_local = is_local || localhost_only;
        if is_local {
            network.interfaces.push(Ipv4Addr::LOCALHOST);
        }
        // With ROS_LOCALHOST_ONLY, rmw ignores both of the newer variables.
        if let Some(peers) = set("ROS_STATIC_PEERS").filter(|_| !localhost_only) {
            network.notes.extend(unreachable_peers(&peers, is_local));
        }
        Ok(network)
    }

    /// From this process' environment.
    ///
    /// # Errors
    /// [`EnvError`] for a value that says nothing that can be done.
    #[expect(
        clippy::disallowed_methods,
        reason = "these settings are ROS's own and come by the environment"
    )]
    pub fn from_process() -> Result<Self, EnvError> {
        Self::from_variables(|name| std::env::var(name).ok())
    }
}

/// Which keys a node uses among secured peers, by SROS2's variables.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Security {
    enclave_folder: PathBuf,
}

impl Security {
    /// Reads `ROS_SECURITY_ENABLE`, `_STRATEGY`, `_KEYSTORE` and `_ENCLAVE_OVERRIDE` through `get`;
    /// `enclave` is the one that the command line names. `None` where security is not asked for.
    ///
    /// # Errors
    /// [`EnvError`] where it is asked for without saying where the keys are.
    pub fn from_variables(
        get: impl Fn(&str) -> Option<String>,
        enclave: Option<&str>,
    ) -> Result<Option<Self>, EnvError> {
        let set = |name: &str| get(name).filter(|value| !value.trim().is_empty());
        let enable = set("ROS_SECURITY_ENABLE");
        // As rcl has it: this word alone.
        if enable.as_deref() != Some("true") {
            return Ok(None);
        }
        let Some(keystore) = set("ROS_SECURITY_KEYSTORE") else {
            return Err(refused(
                "ROS_SECURITY_KEYSTORE",
                "",
                "must name the keystore when ROS_SECURITY_ENABLE is true",
            ));
        };
        let named = set("ROS_SECURITY_ENCLAVE_OVERRIDE");
        let enclave = named.as_deref().or(enclave).unwrap_or("/");
        let parts: Vec<&str> = enclave.split('/').filter(|part| !part.is_empty()).collect();
        if parts.contains(&"..") {
            return Err(refused(
                "ROS_SECURITY_ENCLAVE_OVERRIDE",
                enclave,
                "leads out of the keystore",
            ));
        }
        let mut enclave_folder = PathBuf::from(keystore).join("enclaves");
        enclave_folder.extend(parts);
        let is_there = enclave_folder.is_dir();
        let is_enforced = set("ROS_SECURITY_STRATEGY").as_deref() == Some("Enforce");
        Ok((is_enforced || is_there).then_some(Self { enclave_folder }))
    }

    /// From this process' environment.
    ///
    /// # Errors
    /// As [`Self::from_variables`].
    #[expect(
        clippy::disallowed_methods,
        reason = "these settings are ROS's own and come by the environment"
    )]
    pub fn from_process(enclave: Option<&str>) -> Result<Option<Self>, EnvError> {
        Self::from_variables(|name| std::env::var(name).ok(), enclave)
    }

    /// The folder with the enclave's keys, certificates and permissions.
    pub fn enclave_folder(&self) -> &Path {
        &self.enclave_folder
    }
}

fn refused(variable: &'static str, value: &str, reason: &'static str) -> EnvError {
    EnvError {
        variable,
        value: value.to_owned(),
        reason,
    }
}

fn domain_id(value: &str) -> Result<u16, EnvError> {
    let parsed = value.trim().parse::<u16>().ok();
    parsed
        .filter(|&id| id <= MAX_DOMAIN)
        .ok_or_else(|| refused("ROS_DOMAIN_ID", value, "is no number from 0 to 232"))
}

/// Peers on this host are found anyway; others only by multicast.
fn unreachable_peers(peers: &str, is_local: bool) -> Option<String> {
    let is_here = |peer: &str| peer == "localhost" || peer.starts_with("127.");
    let others: Vec<&str> = peers
        .split(';')
        .map(str::trim)
        .filter(|peer| !peer.is_empty() && !is_here(peer))
        .collect();
    if others.is_empty() {
        return None;
    }
    let remedy = if is_local {
        "set ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET"
    } else {
        "peers on the same subnet are found by multicast; for others run this node beside them, or a DDS router between"
    };
    Some(format!(
        "ROS_STATIC_PEERS names {}, but this node's DDS has no static peers: {remedy}",
        others.join(", ")
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn network(pairs: &[(&str, &str)]) -> Result<Network, EnvError> {
        Network::from_variables(|name| {
            let found = pairs.iter().find(|(n, _)| *n == name);
            found.map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn nothing_set_is_domain_0_on_all_interfaces() {
        assert_eq!(network(&[]).unwrap(), Network::default());
        let empty = [("ROS_DOMAIN_ID", ""), ("ROS_LOCALHOST_ONLY", " ")];
        assert_eq!(network(&empty).unwrap(), Network::default());
    }

    #[test]
    fn domains_are_bounded_by_the_ports() {
        assert_eq!(network(&[("ROS_DOMAIN_ID", "91")]).unwrap().domain_id, 91);
        assert_eq!(network(&[("ROS_DOMAIN_ID", "232")]).unwrap().domain_id, 232);
        for bad in ["233", "-1", "x", "70000"] {
            assert!(network(&[("ROS_DOMAIN_ID", bad)]).is_err(), "{bad}");
        }
    }

    #[test]
    fn either_variable_keeps_the_node_on_this_host() {
        for pair in [
            ("ROS_LOCALHOST_ONLY", "1"),
            ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"),
            ("ROS_AUTOMATIC_DISCOVERY_RANGE", "localhost"),
        ] {
            let found = network(&[pair]).unwrap();
            assert_eq!(found.interfaces, [Ipv4Addr::LOCALHOST], "{pair:?}");
        }
        let wide = [
            ("ROS_LOCALHOST_ONLY", "0"),
            ("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET"),
        ];
        assert!(network(&wide).unwrap().interfaces.is_empty());
    }

    #[test]
    fn secured_peers_are_asked_for_as_rcl_asks() {
        let dir = tempfile::tempdir().unwrap();
        let keystore = dir.path().to_str().unwrap().to_owned();
        std::fs::create_dir_all(dir.path().join("enclaves/robot/veneer")).unwrap();
        let security = |pairs: &[(&str, &str)], enclave| {
            Security::from_variables(
                |name| {
                    let found = pairs.iter().find(|(n, _)| *n == name);
                    found.map(|(_, value)| (*value).to_owned())
                },
                enclave,
            )
        };
        let enable = ("ROS_SECURITY_ENABLE", "true");
        let store = ("ROS_SECURITY_KEYSTORE", keystore.as_str());
        let enforce = ("ROS_SECURITY_STRATEGY", "Enforce");
        assert_eq!(security(&[store, enforce], None), Ok(None));
        assert!(security(&[enable], None).is_err());
        let found = security(&[enable, store], Some("/robot/veneer")).unwrap();
        let folder = dir.path().join("enclaves/robot/veneer");
        assert_eq!(found.unwrap().enclave_folder(), folder);
        // Without Enforce, a node whose keys are missing goes on without security; with it, not.
        assert_eq!(security(&[enable, store], Some("/other")), Ok(None));
        assert!(
            security(&[enable, store, enforce], Some("/other"))
                .unwrap()
                .is_some()
        );
        assert!(security(&[enable, store], Some("/../../x")).is_err());
    }

    #[test]
    fn what_cannot_be_done_is_refused_or_told() {
        assert!(network(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")]).is_err());
        assert!(network(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "WIDE")]).is_err());
        assert!(network(&[("ROS_LOCALHOST_ONLY", "yes")]).is_err());
        let peers = [("ROS_STATIC_PEERS", "127.0.0.1;10.0.0.7; robot ")];
        let notes = network(&peers).unwrap().notes;
        assert_eq!(notes.len(), 1);
        assert!(notes[0].contains("10.0.0.7, robot"), "{notes:?}");
        let local = [("ROS_STATIC_PEERS", "localhost;127.0.0.2")];
        assert!(network(&local).unwrap().notes.is_empty());
    }
}
