//! The one reader of settings: values that a TOML or JSON text holds, into any type of settings.
//!
//! A text is parsed into values first, whatever its format; types are read from those. So every type has its reading
//! compiled once, not once per format and way. A mistake knows the path of its key; where a text is at hand, the path
//! leads to line and column.

use crate::error::{Error, Result, in_words, unknown_key_remedy};
use serde::de::value::BorrowedStrDeserializer;
use serde::de::{self, DeserializeOwned, DeserializeSeed, Error as _, Expected, IgnoredAny, Unexpected, Visitor};
use serde::forward_to_deserialize_any;
use std::fmt;
use std::ops::Range;

/// What a text of TOML says; `file` is for messages.
///
/// # Errors
/// [`Error::Format`] with line and column, and for an unknown key with the nearest known one.
pub fn of_toml<T: DeserializeOwned>(text: &str, file: &str) -> Result<T> {
    of_text(text).map_err(|mistake| mistake.error(text, file))
}

/// The same, with the mistake as it is.
pub fn of_text<T: DeserializeOwned>(text: &str) -> std::result::Result<T, Mistake> {
    of_table(&table(text)?).map_err(|fault| Mistake { span: fault.span(text), message: fault.message().into() })
}

/// The table of a text of TOML; `file` is for messages.
///
/// # Errors
/// [`Error::Format`] with line and column for text that is no TOML.
pub fn parse(text: &str, file: &str) -> Result<toml::Table> {
    table(text).map_err(|mistake| mistake.error(text, file))
}

fn table(text: &str) -> std::result::Result<toml::Table, Mistake> {
    toml::from_str(text).map_err(|error| Mistake { span: error.span(), message: error.message().into() })
}

/// What is wrong with a text, and where.
#[derive(Debug)]
pub struct Mistake {
    pub span: Option<Range<usize>>,
    pub message: String,
}

impl Mistake {
    fn error(&self, text: &str, file: &str) -> Error {
        let place = self.span.as_ref().map_or_else(|| WHOLE.into(), |span| line_and_column(text, span));
        format(file, place, &self.message)
    }
}

/// How messages call what has no key.
const WHOLE: &str = "the settings";

/// What a text of JSON says; `file` and `remedy` are for messages.
///
/// # Errors
/// [`Error::Format`] with line and column, and with the path of the key for what has another type.
pub fn of_json<T: DeserializeOwned>(text: &[u8], file: &str, remedy: &str) -> Result<T> {
    let format = |place: String, rule: String| Error::Format { file: file.into(), place, rule, remedy: remedy.into() };
    let at = |e: &serde_json::Error| format!("line {}, column {}", e.line(), e.column());
    let value: serde_json::Value = serde_json::from_slice(text).map_err(|e| format(at(&e), e.to_string()))?;
    T::deserialize(Reader(Value::Json(&value))).map_err(|fault| {
        let ended = Way(&fault.0.steps).deserialize(&mut serde_json::Deserializer::from_slice(text));
        let place = ended.err().as_ref().map(at);
        format(fault.path().into_iter().chain(place).collect::<Vec<_>>().join(", "), fault.rule())
    })
}

/// The way to a value of a text, the next step last: reading ends there with an error, which knows line and column.
struct Way<'a>(&'a [Step]);

impl<'de> DeserializeSeed<'de> for Way<'_> {
    type Value = ();
    fn deserialize<D: de::Deserializer<'de>>(self, text: D) -> std::result::Result<(), D::Error> {
        text.deserialize_any(self)
    }
}

// numbers and texts end it of themselves
impl<'de> Visitor<'de> for Way<'_> {
    type Value = ();
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the end of the way")
    }
    fn visit_map<A: de::MapAccess<'de>>(self, mut table: A) -> std::result::Result<(), A::Error> {
        if let Some((Step::Key(key), rest)) = self.0.split_last() {
            while let Some(own) = table.next_key::<String>()? {
                match own == *key {
                    true => return table.next_value_seed(Way(rest)),
                    false => drop(table.next_value::<IgnoredAny>()?),
                }
            }
        }
        Err(A::Error::custom("here"))
    }
    fn visit_seq<A: de::SeqAccess<'de>>(self, mut list: A) -> std::result::Result<(), A::Error> {
        if let Some((Step::Index(i), rest)) = self.0.split_last() {
            for _ in 0..*i {
                list.next_element::<IgnoredAny>()?;
            }
            list.next_element_seed(Way(rest))?;
        }
        Err(A::Error::custom("here"))
    }
}

/// What a table says.
pub fn of_table<T: DeserializeOwned>(table: &toml::Table) -> std::result::Result<T, Fault> {
    T::deserialize(Reader(Value::Table(table)))
}

/// What a value says.
pub fn of_value<T: DeserializeOwned>(value: &toml::Value) -> std::result::Result<T, Fault> {
    T::deserialize(Reader(Value::Toml(value)))
}

/// Why a value cannot be read, and where.
#[derive(Debug)]
pub struct Fault(Box<Place>);

#[derive(Debug)]
struct Place {
    message: String,
    /// From the innermost outwards.
    steps: Vec<Step>,
    /// The key that is wrong, of the innermost table.
    key: Option<String>,
}

#[derive(Debug)]
enum Step {
    Key(String),
    Index(usize),
}

impl Fault {
    /// As serde says it.
    pub fn message(&self) -> &str {
        &self.0.message
    }

    /// In one line, in words of numbers.
    fn rule(&self) -> String {
        in_words(&self.message().lines().collect::<Vec<_>>().join(" "))
    }

    /// Keys of tables, from the outermost on; none for the whole.
    fn path(&self) -> Option<String> {
        let keys = self.0.steps.iter().rev().filter_map(|step| match step {
            Step::Key(key) => Some(key.as_str()),
            Step::Index(_) => None,
        });
        let path = keys.collect::<Vec<_>>().join(".");
        Some(path).filter(|path| !path.is_empty())
    }

    /// Of a table that comes from no text.
    pub fn in_table(&self, file: &str) -> Error {
        format(file, self.path().unwrap_or_else(|| WHOLE.into()), self.message())
    }

    /// Of the text that the table was parsed from.
    pub fn in_text(&self, text: &str, file: &str) -> Error {
        Mistake { span: self.span(text), message: self.message().into() }.error(text, file)
    }

    /// Where the value stands, or the key that is wrong.
    fn span(&self, text: &str) -> Option<Range<usize>> {
        let root = toml::de::DeTable::parse(text).ok()?;
        let (mut span, mut table, mut list) = (root.span(), Some(root.get_ref()), None);
        for step in self.0.steps.iter().rev() {
            let value: &toml::Spanned<toml::de::DeValue<'_>> = match step {
                Step::Key(key) => table?.iter().find(|(k, _)| k.get_ref() == key)?.1,
                Step::Index(i) => {
                    let list: &toml::de::DeArray<'_> = list?;
                    list.get(*i)?
                }
            };
            (span, table, list) = (value.span(), value.get_ref().as_table(), value.get_ref().as_array());
        }
        let key = self.0.key.as_ref().and_then(|key| table?.iter().find(|(k, _)| k.get_ref() == key));
        Some(key.map_or(span, |(key, _)| key.span()))
    }

    #[cold]
    #[inline(never)]
    fn within(mut self, step: Step) -> Self {
        self.0.steps.push(step);
        self
    }

    #[cold]
    #[inline(never)]
    fn at_key(mut self, key: &str) -> Self {
        self.0.key = Some(key.into());
        self
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.message())
    }
}

impl std::error::Error for Fault {}

impl de::Error for Fault {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self(Box::new(Place { message: message.to_string(), steps: Vec::new(), key: None }))
    }

    fn invalid_type(found: Unexpected<'_>, expected: &dyn Expected) -> Self {
        match found {
            Unexpected::Unit => Self::custom(format_args!("invalid type: null, expected {expected}")),
            found => Self::custom(format_args!("invalid type: {found}, expected {expected}")),
        }
    }
}

/// A mistake of a text, with the remedy for a key that is none.
fn format(file: &str, place: String, message: &str) -> Error {
    let rule = in_words(&message.lines().collect::<Vec<_>>().join(" "));
    let remedy = unknown_key_remedy(&rule).unwrap_or_else(|| "Correct it there.".into());
    Error::Format { file: file.into(), place, rule, remedy }
}

fn line_and_column(text: &str, span: &Range<usize>) -> String {
    let before = text.get(..span.start).unwrap_or(text);
    let line_start = before.rfind('\n').map_or(0, |i| i + 1);
    format!("line {}, column {}", before.matches('\n').count() + 1, before[line_start..].chars().count() + 1)
}

/// What there is to be read.
#[derive(Clone, Copy)]
enum Value<'de> {
    Table(&'de toml::Table),
    Toml(&'de toml::Value),
    Json(&'de serde_json::Value),
}

/// A value by its kind.
enum Kind<'de> {
    Nothing,
    Truth(bool),
    Integer(i64),
    Unsigned(u64),
    Real(f64),
    Text(&'de str),
    Date(&'de toml::value::Datetime),
    List(Vec<Value<'de>>),
    Table(Vec<(&'de str, Value<'de>)>),
}

impl<'de> Value<'de> {
    fn kind(self) -> Kind<'de> {
        match self {
            Self::Table(own) | Self::Toml(toml::Value::Table(own)) => {
                Kind::Table(own.iter().map(|(key, value)| (key.as_str(), Value::Toml(value))).collect())
            }
            Self::Toml(toml::Value::String(own)) => Kind::Text(own),
            Self::Toml(toml::Value::Integer(own)) => Kind::Integer(*own),
            Self::Toml(toml::Value::Float(own)) => Kind::Real(*own),
            Self::Toml(toml::Value::Boolean(own)) => Kind::Truth(*own),
            Self::Toml(toml::Value::Datetime(own)) => Kind::Date(own),
            Self::Toml(toml::Value::Array(own)) => Kind::List(own.iter().map(Value::Toml).collect()),
            Self::Json(serde_json::Value::Null) => Kind::Nothing,
            Self::Json(serde_json::Value::Bool(own)) => Kind::Truth(*own),
            Self::Json(serde_json::Value::Number(own)) => match (own.as_u64(), own.as_i64()) {
                (Some(own), _) => Kind::Unsigned(own),
                (None, Some(own)) => Kind::Integer(own),
                (None, None) => Kind::Real(own.as_f64().unwrap_or(f64::NAN)),
            },
            Self::Json(serde_json::Value::String(own)) => Kind::Text(own),
            Self::Json(serde_json::Value::Array(own)) => Kind::List(own.iter().map(Value::Json).collect()),
            Self::Json(serde_json::Value::Object(own)) => {
                Kind::Table(own.iter().map(|(key, value)| (key.as_str(), Value::Json(value))).collect())
            }
        }
    }
}

impl Kind<'_> {
    /// That it is not what was asked for.
    #[cold]
    #[inline(never)]
    fn unlike(&self, expected: &dyn Expected) -> Fault {
        let found = match self {
            Self::Nothing => Unexpected::Unit,
            Self::Truth(own) => Unexpected::Bool(*own),
            Self::Integer(own) => Unexpected::Signed(*own),
            Self::Unsigned(own) => Unexpected::Unsigned(*own),
            Self::Real(own) => Unexpected::Float(*own),
            Self::Text(own) => Unexpected::Str(own),
            Self::Date(own) => return Fault::invalid_type(Unexpected::Str(&own.to_string()), expected),
            Self::List(_) => Unexpected::Seq,
            Self::Table(_) => Unexpected::Map,
        };
        Fault::invalid_type(found, expected)
    }
}

/// Reads one value.
#[derive(Clone, Copy)]
struct Reader<'de>(Value<'de>);

impl<'de> Reader<'de> {
    fn list<V: Visitor<'de>>(list: Vec<Value<'de>>, visitor: V) -> std::result::Result<V::Value, Fault> {
        let n = list.len();
        let mut items = Items { left: list.into_iter(), at: 0 };
        let value = visitor.visit_seq(&mut items)?;
        if items.left.len() == 0 { Ok(value) } else { Err(Fault::invalid_length(n, &"fewer elements in array")) }
    }

    fn table<V: Visitor<'de>>(table: Vec<(&'de str, Value<'de>)>, visitor: V) -> std::result::Result<V::Value, Fault> {
        visitor.visit_map(Entries { left: table.into_iter(), value: None })
    }
}

impl<'de> de::Deserializer<'de> for Reader<'de> {
    type Error = Fault;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> std::result::Result<V::Value, Fault> {
        match self.0.kind() {
            Kind::Nothing => visitor.visit_unit(),
            Kind::Truth(own) => visitor.visit_bool(own),
            Kind::Integer(own) => visitor.visit_i64(own),
            Kind::Unsigned(own) => visitor.visit_u64(own),
            Kind::Real(own) => visitor.visit_f64(own),
            Kind::Text(own) => visitor.visit_borrowed_str(own),
            Kind::Date(own) => visitor.visit_string(own.to_string()),
            Kind::List(own) => Self::list(own, visitor),
            Kind::Table(own) => Self::table(own, visitor),
        }
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> std::result::Result<V::Value, Fault> {
        match self.0 {
            Value::Json(serde_json::Value::Null) => visitor.visit_none(),
            _ => visitor.visit_some(self),
        }
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> std::result::Result<V::Value, Fault> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> std::result::Result<V::Value, Fault> {
        match self.0.kind() {
            Kind::List(own) => Self::list(own, visitor),
            other => Err(other.unlike(&visitor)),
        }
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, _: usize, visitor: V) -> std::result::Result<V::Value, Fault> {
        self.deserialize_seq(visitor)
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> std::result::Result<V::Value, Fault> {
        match self.0.kind() {
            Kind::Table(own) => Self::table(own, visitor),
            other => Err(other.unlike(&visitor)),
        }
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> std::result::Result<V::Value, Fault> {
        self.deserialize_map(visitor)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> std::result::Result<V::Value, Fault> {
        let choice = match self.0.kind() {
            Kind::Text(name) => Choice { name, value: None },
            Kind::Table(own) => match own[..] {
                [(name, value)] => Choice { name, value: Some(value) },
                [] => return Err(Fault::custom("wanted exactly 1 element, found 0 elements")),
                _ => return Err(Fault::custom("wanted exactly 1 element, more than 1 element")),
            },
            _ => return Err(Fault::custom("wanted string or table")),
        };
        visitor.visit_enum(choice)
    }

    fn deserialize_ignored_any<V: Visitor<'de>>(self, visitor: V) -> std::result::Result<V::Value, Fault> {
        visitor.visit_unit()
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf unit unit_struct tuple_struct
        identifier
    }
}

/// Of a list.
struct Items<'de> {
    left: std::vec::IntoIter<Value<'de>>,
    at: usize,
}

impl<'de> de::SeqAccess<'de> for &mut Items<'de> {
    type Error = Fault;

    fn next_element_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> std::result::Result<Option<T::Value>, Fault> {
        let Some(value) = self.left.next() else { return Ok(None) };
        self.at += 1;
        seed.deserialize(Reader(value)).map(Some).map_err(|fault| fault.within(Step::Index(self.at - 1)))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.left.len())
    }
}

/// Of a table.
struct Entries<'de> {
    left: std::vec::IntoIter<(&'de str, Value<'de>)>,
    value: Option<(&'de str, Value<'de>)>,
}

impl<'de> de::MapAccess<'de> for Entries<'de> {
    type Error = Fault;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> std::result::Result<Option<K::Value>, Fault> {
        self.value = self.left.next();
        let Some((key, _)) = self.value else { return Ok(None) };
        seed.deserialize(BorrowedStrDeserializer::new(key)).map(Some).map_err(|fault: Fault| fault.at_key(key))
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> std::result::Result<V::Value, Fault> {
        let Some((key, value)) = self.value.take() else { return Err(Fault::custom("value is missing")) };
        seed.deserialize(Reader(value)).map_err(|fault| fault.within(Step::Key(key.into())))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.left.len())
    }
}

/// One variant of several: its name, or a table of its name alone.
struct Choice<'de> {
    name: &'de str,
    value: Option<Value<'de>>,
}

impl<'de> de::EnumAccess<'de> for Choice<'de> {
    type Error = Fault;
    type Variant = Content<'de>;

    fn variant_seed<V: DeserializeSeed<'de>>(self, seed: V) -> std::result::Result<(V::Value, Self::Variant), Fault> {
        let place = |fault: Fault| if self.value.is_some() { fault.at_key(self.name) } else { fault };
        let variant = seed.deserialize(BorrowedStrDeserializer::new(self.name)).map_err(place)?;
        Ok((variant, Content(self)))
    }
}

/// What a variant holds.
struct Content<'de>(Choice<'de>);

impl<'de> Content<'de> {
    fn read<T>(
        self,
        what: &str,
        read: impl FnOnce(Reader<'de>) -> std::result::Result<T, Fault>,
    ) -> std::result::Result<T, Fault> {
        match self.0.value {
            None => Err(Fault::invalid_type(Unexpected::UnitVariant, &what)),
            Some(value) => read(Reader(value)).map_err(|fault| fault.within(Step::Key(self.0.name.into()))),
        }
    }
}

impl<'de> de::VariantAccess<'de> for Content<'de> {
    type Error = Fault;

    fn unit_variant(self) -> std::result::Result<(), Fault> {
        match self.0.value.map(Value::kind) {
            None => Ok(()),
            Some(Kind::Table(own)) if own.is_empty() => Ok(()),
            Some(other) => Err(other.unlike(&"an empty table")),
        }
    }

    fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> std::result::Result<T::Value, Fault> {
        self.read("newtype variant", |reader| seed.deserialize(reader))
    }

    fn tuple_variant<V: Visitor<'de>>(self, n: usize, visitor: V) -> std::result::Result<V::Value, Fault> {
        self.read("tuple variant", |reader| de::Deserializer::deserialize_tuple(reader, n, visitor))
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        fields: &'static [&'static str],
        visitor: V,
    ) -> std::result::Result<V::Value, Fault> {
        self.read("struct variant", |reader| de::Deserializer::deserialize_struct(reader, "", fields, visitor))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Own {
        mass: f64,
        arm: Option<[f64; 3]>,
        #[serde(default)]
        shape: Vec<Shape>,
    }

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(rename_all = "snake_case", deny_unknown_fields)]
    enum Shape {
        Point,
        Ball { radius: f64 },
    }

    #[test]
    fn what_a_text_says_is_read_from_toml_and_json_alike() {
        let toml = "mass = 2\narm = [1, 0.5, -1e-3]\nshape = ['point', { ball = { radius = 3 } }]";
        let json = r#"{"mass": 2, "arm": [1, 0.5, -1e-3], "shape": ["point", {"ball": {"radius": 3}}]}"#;
        let own =
            Own { mass: 2.0, arm: Some([1.0, 0.5, -1e-3]), shape: vec![Shape::Point, Shape::Ball { radius: 3.0 }] };
        assert_eq!(of_toml::<Own>(toml, "my.toml").unwrap(), own);
        assert_eq!(of_json::<Own>(json.as_bytes(), "my.json", "").unwrap(), own);
        let none = of_json::<Own>(br#"{"mass": 2, "arm": null}"#, "my.json", "").unwrap();
        assert_eq!(none, Own { mass: 2.0, arm: None, shape: Vec::new() });
    }

    #[test]
    fn a_mistake_is_told_with_its_place_in_lists_and_variants_too() {
        let rest = "mass = 1\n";
        for (text, place, rule) in [
            ("mass = 'a'", "line 1, column 8", "invalid type: string \"a\", expected a number"),
            ("mass = 1\nmas = 2", "line 2, column 1", "unknown field `mas`, expected one of `mass`, `arm`, `shape`"),
            ("arm = [1, 2, 3]", "line 1, column 1", "missing field `mass`"),
            (
                &format!("{rest}arm = [1, true, 3]"),
                "line 2, column 11",
                "invalid type: boolean `true`, expected a number",
            ),
            (&format!("{rest}arm = [1, 2]"), "line 2, column 7", "invalid length 2, expected an array of length 3"),
            (
                &format!("{rest}arm = [1, 2, 3, 4]"),
                "line 2, column 7",
                "invalid length 4, expected fewer elements in array",
            ),
            (
                &format!("{rest}shape = ['pont']"),
                "line 2, column 10",
                "unknown variant `pont`, expected `point` or `ball`",
            ),
            (
                &format!("{rest}[[shape]]\nball = {{ radius = 1 }}\n[[shape]]\nball = {{ radios = 1 }}"),
                "line 5, column 10",
                "unknown field `radios`, expected `radius`",
            ),
            (
                &format!("{rest}shape = [{{ ball = [1.0] }}]"),
                "line 2, column 19",
                "invalid type: sequence, expected struct",
            ),
            (&format!("{rest}shape = [{{}}]"), "line 2, column 10", "wanted exactly 1 element, found 0 elements"),
            (&format!("{rest}shape = [3]"), "line 2, column 10", "wanted string or table"),
            ("mass = ", "line 1, column 8", "string values must be quoted"),
        ] {
            let error = of_toml::<Own>(text, "my.toml").unwrap_err().to_string();
            assert!(error.starts_with(&format!("my.toml: {place}: {rule}")), "{text}: {error}");
        }
        for (text, place) in [
            (
                r#"{"mass": 1, "arm": [1, "b", 3]}"#,
                "my.json: arm, line 1, column 26: invalid type: string \"b\", expected a number. Mend it.",
            ),
            (r#"{"mass": null}"#, "my.json: mass, line 1, column 13: invalid type: null, expected a number. Mend it."),
            (r#"{"arm": null}"#, "my.json: line 1, column 1: missing field `mass`. Mend it."),
            (r#"{"mass": 1"#, "my.json: line 1, column 10: EOF while parsing an object at line 1 column 10. Mend it."),
        ] {
            assert_eq!(of_json::<Own>(text.as_bytes(), "my.json", "Mend it.").unwrap_err().to_string(), place);
        }
    }
}
