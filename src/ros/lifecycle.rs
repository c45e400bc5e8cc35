//! The managed node's states, as `rcl_lifecycle` numbers and names them: a state machine without
//! I/O. Transitions take no time here, so only primary states are ever seen.

/// A primary state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum State {
    /// Nothing is set up.
    Unconfigured,
    /// Set up, and deaf and mute.
    Inactive,
    /// At work.
    Active,
    /// Done for good.
    Finalized,
}

impl State {
    /// All of them.
    pub const ALL: [Self; 4] = [
        Self::Unconfigured,
        Self::Inactive,
        Self::Active,
        Self::Finalized,
    ];

    /// Its number in `lifecycle_msgs/State`.
    pub fn id(self) -> u8 {
        match self {
            Self::Unconfigured => 1,
            Self::Inactive => 2,
            Self::Active => 3,
            Self::Finalized => 4,
        }
    }

    /// Its name in `lifecycle_msgs/State`.
    pub fn label(self) -> &'static str {
        match self {
            Self::Unconfigured => "unconfigured",
            Self::Inactive => "inactive",
            Self::Active => "active",
            Self::Finalized => "finalized",
        }
    }
}

/// A transition that somebody may ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Transition {
    /// Unconfigured to inactive.
    Configure,
    /// Inactive to unconfigured.
    Cleanup,
    /// Inactive to active.
    Activate,
    /// Active to inactive.
    Deactivate,
    /// From anywhere to finalized.
    Shutdown,
}

impl Transition {
    const ALL: [Self; 5] = [
        Self::Configure,
        Self::Cleanup,
        Self::Activate,
        Self::Deactivate,
        Self::Shutdown,
    ];

    /// Its name in `lifecycle_msgs/Transition`.
    pub fn label(self) -> &'static str {
        match self {
            Self::Configure => "configure",
            Self::Cleanup => "cleanup",
            Self::Activate => "activate",
            Self::Deactivate => "deactivate",
            Self::Shutdown => "shutdown",
        }
    }

    /// Its number in `lifecycle_msgs/Transition`, from `state`: shutting down has one for each.
    pub fn id(self, state: State) -> u8 {
        match (self, state) {
            (Self::Configure, _) => 1,
            (Self::Cleanup, _) => 2,
            (Self::Activate, _) => 3,
            (Self::Deactivate, _) => 4,
            (Self::Shutdown, State::Inactive) => 6,
            (Self::Shutdown, State::Active) => 7,
            (Self::Shutdown, _) => 5,
        }
    }

    /// The state on the way, number and name, as `get_available_transitions` has it.
    pub fn on_the_way(self) -> (u8, &'static str) {
        match self {
            Self::Configure => (10, "configuring"),
            Self::Cleanup => (11, "cleaningup"),
            Self::Shutdown => (12, "shuttingdown"),
            Self::Activate => (13, "activating"),
            Self::Deactivate => (14, "deactivating"),
        }
    }

    /// Where it leads from `state`; `None` where it does not start there.
    pub fn goal(self, state: State) -> Option<State> {
        match (self, state) {
            (Self::Configure, State::Unconfigured) | (Self::Deactivate, State::Active) => {
                Some(State::Inactive)
            }
            (Self::Cleanup, State::Inactive) => Some(State::Unconfigured),
            (Self::Activate, State::Inactive) => Some(State::Active),
            (Self::Shutdown, State::Unconfigured | State::Inactive | State::Active) => {
                Some(State::Finalized)
            }
            _ => None,
        }
    }

    /// The transition that a request names from `state`: by number, or where that is 0 by name.
    pub fn requested(state: State, id: u8, label: &str) -> Option<Self> {
        let available = Self::available(state);
        available.into_iter().find(|transition| {
            if id != 0 {
                // Any of the numbers for shutting down will do.
                transition.id(state) == id
                    || (*transition == Self::Shutdown && (5..=7).contains(&id))
            } else {
                transition.label() == label
            }
        })
    }

    /// The transitions that start at `state`.
    pub fn available(state: State) -> Vec<Self> {
        let starts_here = |transition: &Self| transition.goal(state).is_some();
        Self::ALL.into_iter().filter(starts_here).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_manager_takes_the_node_up_and_down() {
        let mut state = State::Unconfigured;
        for (id, goal) in [
            (1, State::Inactive),
            (3, State::Active),
            (4, State::Inactive),
            (2, State::Unconfigured),
            (1, State::Inactive),
            (6, State::Finalized),
        ] {
            let transition = Transition::requested(state, id, "").unwrap();
            state = transition.goal(state).unwrap();
            assert_eq!(state, goal, "transition {id}");
        }
        assert!(Transition::available(State::Finalized).is_empty());
    }

    #[test]
    fn what_does_not_start_here_is_refused() {
        assert_eq!(Transition::requested(State::Unconfigured, 3, ""), None);
        assert_eq!(Transition::requested(State::Active, 1, ""), None);
        assert_eq!(Transition::requested(State::Active, 99, ""), None);
        assert_eq!(Transition::requested(State::Active, 0, "configure"), None);
        assert_eq!(
            Transition::requested(State::Active, 0, "deactivate"),
            Some(Transition::Deactivate)
        );
    }

    #[test]
    fn every_available_transition_can_be_asked_for_by_its_number() {
        for state in State::ALL {
            for transition in Transition::available(state) {
                let id = transition.id(state);
                assert_eq!(Transition::requested(state, id, ""), Some(transition));
            }
        }
    }
}
