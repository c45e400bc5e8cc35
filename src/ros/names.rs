//! Names of nodes, topics and services: expanding them and remapping them, as rcl does.
//!
//! A name is absolute (`/a/b`), relative to the node's namespace (`a/b`), or private to the node
//! (`~/a`). Rules are tried in the order in which they were given; the first whose left side
//! expands to the name wins. Pure: no DDS, no environment.

/// Why a name was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{kind} name '{name}' {reason}")]
pub struct NameError {
    /// What kind of name.
    pub kind: &'static str,
    /// The name as given.
    pub name: String,
    /// What is wrong with it.
    pub reason: &'static str,
}

/// A node's namespace and name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeIdentity {
    namespace: String,
    base_name: String,
}

impl NodeIdentity {
    /// A node `base_name` in `namespace`, which gets its leading slash where it lacks one.
    ///
    /// # Errors
    /// [`NameError`] for names that ROS refuses.
    pub fn new(namespace: &str, base_name: &str) -> Result<Self, NameError> {
        let namespace = format!("/{}", namespace.trim_matches('/'));
        if namespace != "/" {
            check_tokens("namespace", &namespace)?;
        }
        if base_name.contains('/') {
            return Err(NameError {
                kind: "node",
                name: base_name.to_owned(),
                reason: "holds a slash; set the namespace by __ns",
            });
        }
        check_token("node", base_name, base_name)?;
        Ok(Self {
            namespace,
            base_name: base_name.to_owned(),
        })
    }

    /// The namespace, `/` or `/a/b`.
    pub fn namespace(&self) -> &str {
        &self.namespace
    }

    /// The name without namespace.
    pub fn base_name(&self) -> &str {
        &self.base_name
    }

    /// `/namespace/name`.
    pub fn fully_qualified(&self) -> String {
        join(&self.namespace, &self.base_name)
    }

    /// A topic's or service's absolute name.
    ///
    /// # Errors
    /// [`NameError`] for names that ROS refuses.
    pub fn expand(&self, name: &str) -> Result<String, NameError> {
        let absolute = if let Some(private) = name.strip_prefix("~/") {
            join(&self.fully_qualified(), private)
        } else if name == "~" {
            self.fully_qualified()
        } else if name.starts_with('/') {
            name.to_owned()
        } else {
            join(&self.namespace, name)
        };
        check_tokens("topic", &absolute)?;
        Ok(absolute)
    }
}

fn join(namespace: &str, name: &str) -> String {
    format!("{}/{name}", namespace.trim_end_matches('/'))
}

fn check_tokens(kind: &'static str, absolute: &str) -> Result<(), NameError> {
    let tokens = absolute.strip_prefix('/').unwrap_or(absolute);
    tokens
        .split('/')
        .try_for_each(|token| check_token(kind, token, absolute))
}

fn check_token(kind: &'static str, token: &str, name: &str) -> Result<(), NameError> {
    let refuse = |reason| {
        Err(NameError {
            kind,
            name: name.to_owned(),
            reason,
        })
    };
    let is_letter = |c: char| c.is_ascii_alphabetic() || c == '_';
    match token.chars().next() {
        None => refuse("has an empty part"),
        Some(first) if !is_letter(first) => refuse("has a part that starts with no letter"),
        Some(_) if !token.chars().all(|c| is_letter(c) || c.is_ascii_digit()) => {
            refuse("may hold letters, digits, '_' and '/' only")
        }
        Some(_) if token.contains("__") => refuse("holds '__'"),
        Some(_) => Ok(()),
    }
}

/// One rule: what is called `from` is to be called `to`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Remap {
    from: String,
    to: String,
}

impl Remap {
    /// A rule as given.
    pub fn new(from: &str, to: &str) -> Self {
        let bare = |name: &str| {
            let schemes = ["rostopic://", "rosservice://"];
            let bare = schemes.iter().find_map(|s| name.strip_prefix(s));
            bare.unwrap_or(name).to_owned()
        };
        Self {
            from: bare(from),
            to: bare(to),
        }
    }

    /// What it renames.
    pub fn from(&self) -> &str {
        &self.from
    }
}

/// The node's name and the rules that hold for it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NameResolver {
    node: NodeIdentity,
    rules: Vec<(String, String)>,
}

impl NameResolver {
    /// Expands both sides of every rule.
    ///
    /// # Errors
    /// [`NameError`] for a rule whose sides are no names.
    pub fn new(node: NodeIdentity, remaps: &[Remap]) -> Result<Self, NameError> {
        let rules = remaps
            .iter()
            .map(|remap| Ok((node.expand(&remap.from)?, node.expand(&remap.to)?)))
            .collect::<Result<_, NameError>>()?;
        Ok(Self { node, rules })
    }

    /// The node.
    pub fn node(&self) -> &NodeIdentity {
        &self.node
    }

    /// The absolute name under which `name` is to be used.
    ///
    /// # Errors
    /// [`NameError`] for names that ROS refuses.
    pub fn resolve(&self, name: &str) -> Result<String, NameError> {
        let expanded = self.node.expand(name)?;
        Ok(self.renamed(&expanded).unwrap_or(expanded))
    }

    /// A name that is another's with a suffix, as image transports have it: a rule for the whole
    /// name wins, then one for the base.
    ///
    /// # Errors
    /// [`NameError`] for names that ROS refuses.
    pub fn resolve_transport(&self, base: &str, transport: &str) -> Result<String, NameError> {
        let whole = self.node.expand(&join(base, transport))?;
        match self.renamed(&whole) {
            Some(renamed) => Ok(renamed),
            None => Ok(join(&self.resolve(base)?, transport)),
        }
    }

    fn renamed(&self, expanded: &str) -> Option<String> {
        let rule = self.rules.iter().find(|(from, _)| from == expanded);
        rule.map(|(_, to)| to.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolver(rules: &[(&str, &str)]) -> NameResolver {
        let remaps: Vec<_> = rules.iter().map(|(f, t)| Remap::new(f, t)).collect();
        NameResolver::new(NodeIdentity::new("robot1", "veneer").unwrap(), &remaps).unwrap()
    }

    #[test]
    fn names_expand_as_ros_has_it() {
        let node = NodeIdentity::new("/robot1/", "veneer").unwrap();
        assert_eq!(node.fully_qualified(), "/robot1/veneer");
        for (name, expanded) in [
            ("rgb/image", "/robot1/rgb/image"),
            ("/tf", "/tf"),
            ("~/status", "/robot1/veneer/status"),
        ] {
            assert_eq!(node.expand(name).unwrap(), expanded);
        }
        let root = NodeIdentity::new("", "veneer").unwrap();
        assert_eq!(root.expand("~/status").unwrap(), "/veneer/status");
        assert_eq!(root.expand("mesh").unwrap(), "/mesh");
    }

    #[test]
    fn names_that_ros_refuses_are_refused() {
        let node = NodeIdentity::new("/", "veneer").unwrap();
        for name in ["", "a//b", "/a/", "1a", "a/b c", "a__b", "~", "ä"] {
            let expanded = node.expand(name);
            assert_eq!(expanded.is_ok(), name == "~", "{name}: {expanded:?}");
        }
        assert!(NodeIdentity::new("/", "a/b").is_err());
        assert!(NodeIdentity::new("/", "").is_err());
        assert!(NodeIdentity::new("/a-b", "c").is_err());
    }

    #[test]
    fn the_first_rule_that_fits_wins() {
        let names = resolver(&[
            ("rgb/image", "/front/image_raw"),
            ("/robot1/rgb/image", "/never"),
            ("/tf", "tf"),
            ("~/status", "state"),
        ]);
        for (name, resolved) in [
            ("rgb/image", "/front/image_raw"),
            ("/tf", "/robot1/tf"),
            ("~/status", "/robot1/state"),
            ("mesh", "/robot1/mesh"),
        ] {
            assert_eq!(names.resolve(name).unwrap(), resolved);
        }
    }

    #[test]
    fn a_transport_follows_its_base_unless_named_itself() {
        let names = resolver(&[("rgb/image", "/front/image_raw")]);
        let compressed = names.resolve_transport("rgb/image", "compressed").unwrap();
        assert_eq!(compressed, "/front/image_raw/compressed");
        let names = resolver(&[("rgb/image", "/front"), ("rgb/image/compressed", "/jpeg")]);
        let compressed = names.resolve_transport("rgb/image", "compressed").unwrap();
        assert_eq!(compressed, "/jpeg");
    }
}
