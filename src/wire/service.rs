//! Services: a request and its response are messages of their own, `package/srv/Name_Request` and
//! `…_Response`.
//!
//! The small ones own their data and derive serde's traits in the order of their fields, so that a
//! client library's own CDR writes the same bytes.

pub mod lifecycle;
pub mod mesh;

use serde::{Deserialize, Serialize};

use super::Message;
use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;

/// A service.
pub trait Service {
    /// Its type, `package/srv/Name`.
    const TYPE_NAME: &'static str;
    /// What is asked.
    type Request: for<'a> Message<'a>;
    /// What is answered.
    type Response<'a>: Message<'a>;
}

/// Declares a request or response whose fields are written in order.
macro_rules! plain_message {
    (
        $(#[$doc:meta])*
        $name:ident, $type_name:literal, $schema:expr, { $($(#[$field_doc:meta])* $field:ident: $kind:ty),* }
    ) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
        pub struct $name {
            $($(#[$field_doc])* pub $field: $kind),*
        }

        impl crate::wire::Message<'_> for $name {
            const TYPE_NAME: &'static str = $type_name;
            const SCHEMA: &'static str = $schema;

            fn read(
                reader: &mut crate::wire::CdrReader<'_>,
            ) -> Result<Self, crate::wire::WireError> {
                Ok(Self {
                    $($field: crate::wire::service::Field::read(reader, stringify!($field))?),*
                })
            }

            fn write(&self, writer: &mut crate::wire::CdrWriter) {
                $(crate::wire::service::Field::write(&self.$field, writer);)*
            }
        }
    };
}
pub(crate) use plain_message;

/// A field of a plain message.
pub(crate) trait Field: Sized {
    fn read(reader: &mut CdrReader<'_>, name: &'static str) -> Result<Self, WireError>;
    fn write(&self, writer: &mut CdrWriter);
}

impl Field for bool {
    fn read(reader: &mut CdrReader<'_>, name: &'static str) -> Result<Self, WireError> {
        reader.bool(name)
    }
    fn write(&self, writer: &mut CdrWriter) {
        writer.bool(*self);
    }
}

impl Field for u8 {
    fn read(reader: &mut CdrReader<'_>, name: &'static str) -> Result<Self, WireError> {
        reader.scalar(name)
    }
    fn write(&self, writer: &mut CdrWriter) {
        writer.scalar(*self);
    }
}

impl Field for u32 {
    fn read(reader: &mut CdrReader<'_>, name: &'static str) -> Result<Self, WireError> {
        reader.scalar(name)
    }
    fn write(&self, writer: &mut CdrWriter) {
        writer.scalar(*self);
    }
}

impl Field for u64 {
    fn read(reader: &mut CdrReader<'_>, name: &'static str) -> Result<Self, WireError> {
        reader.scalar(name)
    }
    fn write(&self, writer: &mut CdrWriter) {
        writer.scalar(*self);
    }
}

impl Field for String {
    fn read(reader: &mut CdrReader<'_>, name: &'static str) -> Result<Self, WireError> {
        reader.string(name).map(str::to_owned)
    }
    fn write(&self, writer: &mut CdrWriter) {
        writer.string(self);
    }
}

impl<T: Field> Field for Vec<T> {
    fn read(reader: &mut CdrReader<'_>, name: &'static str) -> Result<Self, WireError> {
        // Every field takes at least a byte.
        reader.sequence(name, 1, |reader| T::read(reader, name))
    }
    fn write(&self, writer: &mut CdrWriter) {
        writer.sequence_len(self.len());
        self.iter().for_each(|element| element.write(writer));
    }
}

/// A request or response without fields. ROS puts one byte there, for DDS has no empty structs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Empty {
    structure_needs_at_least_one_member: u8,
}

impl Empty {
    pub(crate) fn read(reader: &mut CdrReader<'_>) -> Self {
        // Some writers leave the byte out; its value means nothing.
        let byte = reader.scalar("structure_needs_at_least_one_member");
        Self {
            structure_needs_at_least_one_member: byte.unwrap_or(0),
        }
    }

    pub(crate) fn write(self, writer: &mut CdrWriter) {
        writer.scalar(self.structure_needs_at_least_one_member);
    }
}

/// Declares a request without fields.
macro_rules! empty_message {
    ($(#[$doc:meta])* $name:ident, $type_name:literal) => {
        $(#[$doc])*
        #[derive(
            Clone, Copy, Debug, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize,
        )]
        pub struct $name(pub crate::wire::service::Empty);

        impl crate::wire::Message<'_> for $name {
            const TYPE_NAME: &'static str = $type_name;
            const SCHEMA: &'static str = "";

            fn read(
                reader: &mut crate::wire::CdrReader<'_>,
            ) -> Result<Self, crate::wire::WireError> {
                Ok(Self(crate::wire::service::Empty::read(reader)))
            }

            fn write(&self, writer: &mut crate::wire::CdrWriter) {
                self.0.write(writer);
            }
        }
    };
}
pub(crate) use empty_message;

empty_message!(
    /// Request of `std_srvs/Trigger`.
    TriggerRequest,
    "std_srvs/srv/Trigger_Request"
);
plain_message!(
    /// Response of `std_srvs/Trigger`.
    TriggerResponse,
    "std_srvs/srv/Trigger_Response",
    "bool success\nstring message\n",
    {
        /// Whether it was done.
        success: bool,
        /// What was done, or why it was not.
        message: String
    }
);

/// `std_srvs/Trigger`.
#[derive(Clone, Copy, Debug)]
pub struct Trigger;

impl Service for Trigger {
    const TYPE_NAME: &'static str = "std_srvs/srv/Trigger";
    type Request = TriggerRequest;
    type Response<'a> = TriggerResponse;
}

plain_message!(
    /// Request of `veneer/FilePath`.
    FilePathRequest,
    "veneer/srv/FilePath_Request",
    "string file_path\n",
    {
        /// Relative to the folder that the node saves to.
        file_path: String
    }
);
plain_message!(
    /// Response of `veneer/FilePath`.
    FilePathResponse,
    "veneer/srv/FilePath_Response",
    "bool success\nstring message\n",
    {
        /// Whether it was done.
        success: bool,
        /// What was done, or why it was not.
        message: String
    }
);

/// `veneer/FilePath`.
#[derive(Clone, Copy, Debug)]
pub struct FilePath;

impl Service for FilePath {
    const TYPE_NAME: &'static str = "veneer/srv/FilePath";
    type Request = FilePathRequest;
    type Response<'a> = FilePathResponse;
}
