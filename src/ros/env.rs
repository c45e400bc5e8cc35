//! The environment variables that decide whom a ROS 2 node can hear.
//!
//! `ROS_DOMAIN_ID`; `ROS_AUTOMATIC_DISCOVERY_RANGE` (`LOCALHOST`, `SUBNET`, `OFF`,
//! `SYSTEM_DEFAULT`) with `ROS_STATIC_PEERS`; the older `ROS_LOCALHOST_ONLY`, which wins where it
//! is set, as in rmw. What cannot be had is told, not passed over: [`Network::notes`].

use std::net::Ipv4Addr;

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
    /// Names or addresses of other hosts to announce the node to.
    pub static_peers: Vec<String>,
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
                    "leaves no way to find a peer: use LOCALHOST or SUBNET",
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
            let others = others(&peers);
            if is_local && !others.is_empty() {
                network.notes.push(format!(
                    "ROS_STATIC_PEERS names {}, but the node keeps to this host: set \
                     ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET",
                    others.join(", ")
                ));
            } else {
                network.static_peers = others;
            }
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

/// The static peers on other hosts; those on this one are found anyway.
fn others(peers: &str) -> Vec<String> {
    let is_here = |peer: &&str| *peer == "localhost" || peer.starts_with("127.");
    let peers = peers.split(';').map(str::trim);
    let others = peers.filter(|peer| !peer.is_empty() && !is_here(peer));
    others.map(str::to_owned).collect()
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
    fn what_cannot_be_done_is_refused_or_told() {
        assert!(network(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")]).is_err());
        assert!(network(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "WIDE")]).is_err());
        assert!(network(&[("ROS_LOCALHOST_ONLY", "yes")]).is_err());
        let peers = ("ROS_STATIC_PEERS", "127.0.0.1;10.0.0.7; robot ");
        let found = network(&[peers]).unwrap();
        assert_eq!(found.static_peers, ["10.0.0.7", "robot"]);
        assert!(found.notes.is_empty(), "{:?}", found.notes);
        let kept = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
        let found = network(&[peers, kept]).unwrap();
        assert!(found.static_peers.is_empty());
        assert!(
            found.notes[0].contains("10.0.0.7, robot"),
            "{:?}",
            found.notes
        );
        // rmw ignores them with the older variable.
        let found = network(&[peers, ("ROS_LOCALHOST_ONLY", "1")]).unwrap();
        assert!(found.static_peers.is_empty() && found.notes.is_empty());
        let local = [("ROS_STATIC_PEERS", "localhost;127.0.0.2")];
        assert!(network(&local).unwrap().notes.is_empty());
    }
}
