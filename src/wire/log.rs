//! `rcl_interfaces/Log`: a line of `/rosout`.

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::header;
use super::{Message, schema};
use crate::geom::Stamp;

/// `rcl_interfaces/Log`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Log<'a> {
    /// When it was said.
    pub stamp: Stamp,
    /// 10 debug, 20 info, 30 warn, 40 error, 50 fatal.
    pub level: u8,
    /// Who said it.
    pub name: &'a str,
    /// What.
    pub text: &'a str,
    /// File of the source.
    pub file: &'a str,
    /// Function of the source.
    pub function: &'a str,
    /// Line of the source.
    pub line: u32,
}

impl<'a> Message<'a> for Log<'a> {
    const TYPE_NAME: &'static str = "rcl_interfaces/msg/Log";
    const SCHEMA: &'static str = schema::LOG;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            stamp: header::read_time(reader, "stamp.sec", "stamp.nanosec")?,
            level: reader.scalar("level")?,
            name: reader.string("name")?,
            text: reader.string("msg")?,
            file: reader.string("file")?,
            function: reader.string("function")?,
            line: reader.scalar("line")?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        header::write_time(writer, self.stamp);
        writer.scalar(self.level);
        writer.string(self.name);
        writer.string(self.text);
        writer.string(self.file);
        writer.string(self.function);
        writer.scalar(self.line);
    }
}
