//! Schemas that Foxglove and rerun know, as protobuf: what messages are made of, said once, for the descriptor and for the bytes.

use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, EnumValueDescriptorProto, FieldDescriptorProto, FileDescriptorProto,
    FileDescriptorSet,
};

/// Messages of the package `foxglove`: fields by type and name, numbered from 1 on in their order; `*` repeats one, a type in
/// capitals is another message of the package, a list behind a name are values of its enum.
const MESSAGES: [(&str, &str); 20] = [
    ("Vector3", "double x, double y, double z"),
    ("Point3", "double x, double y, double z"),
    ("Quaternion", "double x, double y, double z, double w"),
    ("Pose", "Vector3 position, Quaternion orientation"),
    ("Color", "double r, double g, double b, double a"),
    ("KeyValuePair", "string key, string value"),
    (
        "FrameTransform",
        "time timestamp, string parent_frame_id, string child_frame_id, Vector3 translation, Quaternion rotation",
    ),
    ("FrameTransforms", "*FrameTransform transforms"),
    ("PoseInFrame", "time timestamp, string frame_id, Pose pose"),
    (
        "Log",
        "time timestamp, enum level(UNKNOWN DEBUG INFO WARNING ERROR FATAL), string message, string name, string file, fixed32 line",
    ),
    (
        "ArrowPrimitive",
        "Pose pose, double shaft_length, double shaft_diameter, double head_length, double head_diameter, Color color",
    ),
    ("CubePrimitive", "Pose pose, Vector3 size, Color color"),
    ("SpherePrimitive", "Pose pose, Vector3 size, Color color"),
    ("CylinderPrimitive", "Pose pose, Vector3 size, double bottom_scale, double top_scale, Color color"),
    (
        "LinePrimitive",
        "enum type(LINE_STRIP LINE_LOOP LINE_LIST), Pose pose, double thickness, bool scale_invariant, *Point3 points, \
         Color color, *Color colors, *fixed32 indices",
    ),
    ("TriangleListPrimitive", "Pose pose, *Point3 points, Color color, *Color colors, *fixed32 indices"),
    ("TextPrimitive", "Pose pose, bool billboard, double font_size, bool scale_invariant, Color color, string text"),
    (
        "ModelPrimitive",
        "Pose pose, Vector3 scale, Color color, bool override_color, string url, string media_type, bytes data",
    ),
    ("SceneEntityDeletion", "time timestamp, enum type(MATCHING_ID ALL), string id"),
    (
        "SceneEntity",
        "time timestamp, string frame_id, string id, duration lifetime, bool frame_locked, *KeyValuePair metadata, \
         *ArrowPrimitive arrows, *CubePrimitive cubes, *SpherePrimitive spheres, *CylinderPrimitive cylinders, \
         *LinePrimitive lines, *TriangleListPrimitive triangles, *TextPrimitive texts, *ModelPrimitive models",
    ),
];
/// Names no message above it, and is last.
const SCENE_UPDATE: (&str, &str) = ("SceneUpdate", "*SceneEntityDeletion deletions, *SceneEntity entities");

/// The schema of the package as MCAP wants it: a set of files, the ones that are imported first.
pub fn schema() -> Vec<u8> {
    let moment = |name: &str| DescriptorProto {
        name: Some(name.into()),
        field: vec![number("seconds", 1, Type::Int64), number("nanos", 2, Type::Int32)],
        ..DescriptorProto::default()
    };
    let known = |name: &str| {
        let path = format!("google/protobuf/{}.proto", name.to_lowercase());
        file(&path, "google.protobuf", vec![moment(name)], &[])
    };
    let messages = MESSAGES.iter().chain([&SCENE_UPDATE]).map(|(name, fields)| message(name, fields)).collect();
    let imports = ["google/protobuf/timestamp.proto", "google/protobuf/duration.proto"];
    let own = file("foxglove.proto", "foxglove", messages, &imports);
    FileDescriptorSet { file: vec![known("Timestamp"), known("Duration"), own] }.encode_to_vec()
}

/// The schema of a message of the package `omnidrones` that has a number for each of these names.
pub fn schema_of_numbers(name: &str, columns: &[String]) -> Vec<u8> {
    let field = columns.iter().zip(1..).map(|(column, k)| number(column, k, Type::Double)).collect();
    let message = DescriptorProto { name: Some(name.into()), field, ..DescriptorProto::default() };
    FileDescriptorSet { file: vec![file("omnidrones.proto", "omnidrones", vec![message], &[])] }.encode_to_vec()
}

fn file(path: &str, package: &str, messages: Vec<DescriptorProto>, imports: &[&str]) -> FileDescriptorProto {
    FileDescriptorProto {
        name: Some(path.into()),
        package: Some(package.into()),
        dependency: imports.iter().map(|path| path.to_string()).collect(),
        message_type: messages,
        syntax: Some("proto3".into()),
        ..FileDescriptorProto::default()
    }
}

fn number(name: &str, k: i32, kind: Type) -> FieldDescriptorProto {
    FieldDescriptorProto {
        name: Some(name.into()),
        number: Some(k),
        label: Some(Label::Optional.into()),
        r#type: Some(kind.into()),
        ..FieldDescriptorProto::default()
    }
}

fn message(name: &str, fields: &str) -> DescriptorProto {
    let mut own = DescriptorProto { name: Some(name.into()), ..DescriptorProto::default() };
    for (text, k) in fields.split(", ").zip(1..) {
        let (kind, rest) = text.split_once(' ').unwrap_or((text, ""));
        let (field, values) = rest.split_once('(').unwrap_or((rest, ""));
        let (label, kind) = kind.strip_prefix('*').map_or((Label::Optional, kind), |kind| (Label::Repeated, kind));
        let (kind, of) = match kind {
            "double" => (Type::Double, None),
            "fixed32" => (Type::Fixed32, None),
            "bool" => (Type::Bool, None),
            "string" => (Type::String, None),
            "bytes" => (Type::Bytes, None),
            "time" => (Type::Message, Some(".google.protobuf.Timestamp".into())),
            "duration" => (Type::Message, Some(".google.protobuf.Duration".into())),
            "enum" => {
                let choice = if field == "level" { "Level" } else { "Type" };
                own.enum_type.push(choices(choice, values.trim_end_matches(')')));
                (Type::Enum, Some(format!(".foxglove.{name}.{choice}")))
            }
            other => (Type::Message, Some(format!(".foxglove.{other}"))),
        };
        own.field.push(FieldDescriptorProto { label: Some(label.into()), type_name: of, ..number(field, k, kind) });
    }
    own
}

fn choices(name: &str, values: &str) -> EnumDescriptorProto {
    let value = |(text, k): (&str, i32)| EnumValueDescriptorProto {
        name: Some(text.into()),
        number: Some(k),
        ..EnumValueDescriptorProto::default()
    };
    EnumDescriptorProto {
        name: Some(name.into()),
        value: values.split(' ').zip(0..).map(value).collect(),
        ..EnumDescriptorProto::default()
    }
}

/// A field of a message.
#[derive(Debug, Clone)]
pub enum Value {
    /// Left out: what protobuf takes for zero.
    Nothing,
    Number(f64),
    Whole(u64),
    Text(String),
    Message(Vec<u8>),
    Messages(Vec<Vec<u8>>),
}

/// The bytes of a message: its fields in their order.
pub fn bytes(fields: &[Value]) -> Vec<u8> {
    let mut out = Vec::new();
    for (field, k) in fields.iter().zip(1_u64..) {
        let whole = |n: u64, out: &mut Vec<u8>| prost::encoding::encode_varint(n, out);
        // the lowest three bits of a key are the kind of what follows
        let run = |run: &[u8], out: &mut Vec<u8>| {
            whole(k << 3 | 2, out);
            whole(run.len() as u64, out);
            out.extend_from_slice(run);
        };
        match field {
            Value::Nothing => {}
            Value::Number(x) => {
                whole(k << 3 | 1, &mut out);
                out.extend(x.to_le_bytes());
            }
            Value::Whole(n) => {
                whole(k << 3, &mut out);
                whole(*n, &mut out);
            }
            Value::Text(text) => run(text.as_bytes(), &mut out),
            Value::Message(message) => run(message, &mut out),
            Value::Messages(all) => all.iter().for_each(|message| run(message, &mut out)),
        }
    }
    out
}

/// Numbers as a message of theirs.
pub fn numbers<const N: usize>(numbers: [f64; N]) -> Value {
    Value::Message(bytes(&numbers.map(Value::Number)))
}

/// A time, s.
pub fn time(seconds: f64) -> Value {
    let nanos = nanoseconds(seconds);
    Value::Message(bytes(&[Value::Whole(nanos / 1_000_000_000), Value::Whole(nanos % 1_000_000_000)]))
}

/// The same in whole nanoseconds.
pub fn nanoseconds(seconds: f64) -> u64 {
    (1e9 * seconds).round().max(0.0) as u64
}

/// A pose; the attitude as `[w, x, y, z]`, in the schema as x, y, z, w.
pub fn pose(position: [f64; 3], attitude: [f64; 4]) -> Value {
    Value::Message(bytes(&[numbers(position), quaternion(attitude)]))
}

/// An attitude `[w, x, y, z]`.
pub fn quaternion([w, x, y, z]: [f64; 4]) -> Value {
    numbers([x, y, z, w])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_those_of_the_protobuf_encoding() {
        // examples of protobuf.dev/programming-guides/encoding: 150 in field 1, "testing" in field 2
        assert_eq!(bytes(&[Value::Whole(150)]), [0x08, 0x96, 0x01]);
        assert_eq!(bytes(&[Value::Nothing, Value::Text("testing".into())]), *b"\x12\x07testing");
        assert_eq!(bytes(&[Value::Number(1.0)]), [9, 0, 0, 0, 0, 0, 0, 0xf0, 0x3f]);
    }

    #[test]
    fn every_type_that_is_named_is_there() {
        let set = FileDescriptorSet::decode(&schema()[..]).unwrap();
        let names: Vec<String> = set
            .file
            .iter()
            .flat_map(|f| f.message_type.iter().map(|m| format!(".{}.{}", f.package(), m.name())))
            .collect();
        let fields = set.file.iter().flat_map(|f| &f.message_type).flat_map(|m| &m.field);
        let named: Vec<&str> = fields.filter(|f| f.r#type() == Type::Message).map(|f| f.type_name()).collect();
        assert!(named.len() > 40 && named.iter().all(|name| names.contains(&name.to_string())), "{named:?}");
    }
}
