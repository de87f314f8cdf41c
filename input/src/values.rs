//! Deserializes a TOML table, more strictly than the parser's own deserializer: a struct must be a table, an enum a string,
//! and an array of three must have three entries. An error has the offset of the key or the value that it is about.

use std::fmt;

use serde::de::value::{BorrowedStrDeserializer, StrDeserializer};
use serde::de::{
    DeserializeOwned, DeserializeSeed, Deserializer, Error as _, Expected, IntoDeserializer as _, MapAccess,
    SeqAccess, Unexpected, Visitor,
};
use serde::forward_to_deserialize_any;
use toml::Spanned;
use toml::de::{DeInteger, DeTable, DeValue};

/// A message of serde, and the offset of what it is about; `None`: a key of the outermost table is missing.
#[derive(Debug)]
pub(crate) struct Error {
    pub message: String,
    pub at: Option<usize>,
}

impl Error {
    /// Sets the offset, unless it is set already or the span is empty: such a table has no text of its own.
    fn at<T>(self, spanned: &Spanned<T>) -> Self {
        let span = spanned.span();
        Self { at: self.at.or((!span.is_empty()).then_some(span.start)), ..self }
    }
}

impl serde::de::Error for Error {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self { message: message.to_string(), at: None }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Error {}

/// Deserializes a table.
pub(crate) fn read<T: DeserializeOwned>(table: &DeTable<'_>) -> Result<T, Error> {
    T::deserialize(Table(table))
}

/// The outermost table.
struct Table<'v>(&'v DeTable<'v>);

impl<'v> Deserializer<'v> for Table<'v> {
    type Error = Error;

    fn deserialize_any<V: Visitor<'v>>(self, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_map(Entries { entries: self.0.iter(), value: None })
    }

    forward_to_deserialize_any! {
        <W: Visitor<'v>>
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit unit_struct
        newtype_struct seq tuple tuple_struct map struct enum identifier ignored_any
    }
}

/// A value in a table or an array.
struct Value<'v>(&'v DeValue<'v>);

impl<'v> Value<'v> {
    /// Returns the error for a value of another type than the expected one.
    fn wrong<T>(&self, expected: &dyn Expected) -> Result<T, Error> {
        let found = match self.0 {
            DeValue::String(text) => Unexpected::Str(text),
            DeValue::Array(_) => Unexpected::Seq,
            DeValue::Table(_) => Unexpected::Map,
            other => Unexpected::Other(other.type_str()),
        };
        Err(Error::invalid_type(found, expected))
    }
}

impl<'v> Deserializer<'v> for Value<'v> {
    type Error = Error;

    fn deserialize_any<V: Visitor<'v>>(self, visitor: V) -> Result<V::Value, Error> {
        match self.0 {
            DeValue::String(text) => visitor.visit_str(text),
            DeValue::Integer(number) => integer(number, visitor),
            DeValue::Float(number) => match number.as_str().parse() {
                Ok(number) => visitor.visit_f64(number),
                Err(_) => self.wrong(&visitor),
            },
            DeValue::Boolean(boolean) => visitor.visit_bool(*boolean),
            // No key takes a date.
            DeValue::Datetime(_) => self.wrong(&visitor),
            DeValue::Array(entries) => visitor.visit_seq(Items(entries.iter())),
            DeValue::Table(table) => visitor.visit_map(Entries { entries: table.iter(), value: None }),
        }
    }

    fn deserialize_option<V: Visitor<'v>>(self, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_some(self)
    }

    fn deserialize_newtype_struct<V: Visitor<'v>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, Error> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_tuple<V: Visitor<'v>>(self, length: usize, visitor: V) -> Result<V::Value, Error> {
        match self.0 {
            DeValue::Array(entries) if entries.len() != length => {
                Err(Error::invalid_length(entries.len(), &visitor))
            }
            _ => self.deserialize_any(visitor),
        }
    }

    fn deserialize_struct<V: Visitor<'v>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        match self.0 {
            DeValue::Table(_) => self.deserialize_any(visitor),
            _ => self.wrong(&visitor),
        }
    }

    fn deserialize_enum<V: Visitor<'v>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        match self.0 {
            DeValue::String(name) => {
                let name: StrDeserializer<'_, Error> = (&**name).into_deserializer();
                visitor.visit_enum(name)
            }
            _ => self.wrong(&"a string"),
        }
    }

    forward_to_deserialize_any! {
        <W: Visitor<'v>>
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf unit unit_struct seq
        tuple_struct map identifier ignored_any
    }
}

fn integer<'v, V: Visitor<'v>>(number: &DeInteger<'_>, visitor: V) -> Result<V::Value, Error> {
    let (digits, radix) = (number.as_str(), number.radix());
    if let Ok(number) = i64::from_str_radix(digits, radix) {
        return visitor.visit_i64(number);
    }
    match u64::from_str_radix(digits, radix) {
        Ok(number) => visitor.visit_u64(number),
        Err(_) => Err(Error::invalid_value(Unexpected::Other("integer"), &visitor)),
    }
}

/// The keys and values of a table.
struct Entries<'v, I> {
    entries: I,
    value: Option<&'v Spanned<DeValue<'v>>>,
}

impl<'v, K, I> MapAccess<'v> for Entries<'v, I>
where
    K: AsRef<str> + 'v,
    I: Iterator<Item = (&'v Spanned<K>, &'v Spanned<DeValue<'v>>)>,
{
    type Error = Error;

    fn next_key_seed<S: DeserializeSeed<'v>>(&mut self, seed: S) -> Result<Option<S::Value>, Error> {
        let Some((key, value)) = self.entries.next() else { return Ok(None) };
        self.value = Some(value);
        let name: BorrowedStrDeserializer<'_, Error> = BorrowedStrDeserializer::new(key.get_ref().as_ref());
        seed.deserialize(name).map(Some).map_err(|error| error.at(key))
    }

    fn next_value_seed<S: DeserializeSeed<'v>>(&mut self, seed: S) -> Result<S::Value, Error> {
        let value = self.value.take().ok_or_else(|| Error::custom("a value without a key"))?;
        seed.deserialize(Value(value.get_ref())).map_err(|error| error.at(value))
    }
}

/// The entries of an array.
struct Items<I>(I);

impl<'v, I: Iterator<Item = &'v Spanned<DeValue<'v>>>> SeqAccess<'v> for Items<I> {
    type Error = Error;

    fn next_element_seed<S: DeserializeSeed<'v>>(&mut self, seed: S) -> Result<Option<S::Value>, Error> {
        let next = self.0.next();
        next.map(|value| seed.deserialize(Value(value.get_ref())).map_err(|error| error.at(value)))
            .transpose()
    }
}
