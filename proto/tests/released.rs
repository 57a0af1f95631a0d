//! `rollout.policy.v1` is public: a policy server or client that was written
//! against the released file keeps working with every newer one.

use std::path::Path;

use prost::Message;
use prost_reflect::{
    DescriptorPool, DynamicMessage, FieldDescriptor, Kind, MessageDescriptor, ReflectMessage, Value,
};
use proto::policy;

const PACKAGE: &str = "rollout.policy.v1";

fn compiled(folder: &Path, file: &str) -> DescriptorPool {
    let files = protox::compile([file], [folder]).expect("a correct file");
    DescriptorPool::from_file_descriptor_set(files).expect("a complete descriptor")
}

fn folder() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn released() -> DescriptorPool {
    compiled(&folder().join("released"), "policy_v1.proto")
}

fn current_protocol() -> DescriptorPool {
    compiled(folder(), "rollout/policy/v1/policy.proto")
}

/// Returns the properties of a protocol that must not change, one per line: numbers, names and
/// types on the wire, and calls.
fn properties(pool: &DescriptorPool) -> Vec<String> {
    let mut properties = Vec::new();
    for message in pool.all_messages() {
        properties.push(format!("message {}", message.full_name()));
        properties.extend(message.fields().map(|field| {
            let (kind, name, number) = (field.kind(), field.full_name(), field.number());
            let oneof = field.containing_oneof().map(|oneof| oneof.name().to_owned());
            let (cardinality, presence) = (field.cardinality(), field.supports_presence());
            let packed = field.is_packed();
            format!("{name} = {number}: {cardinality:?} {kind:?} {oneof:?} {presence} {packed}")
        }));
    }
    for values in pool.all_enums() {
        properties.extend(values.values().map(|value| {
            let (name, number) = (value.full_name(), value.number());
            format!("{name} = {number} of {}", values.full_name())
        }));
    }
    for service in pool.services() {
        properties.extend(service.methods().map(|call| {
            let (request, response) = (call.input(), call.output());
            let streams = (call.is_client_streaming(), call.is_server_streaming());
            let (request, response) = (request.full_name(), response.full_name());
            format!("{}({request}) -> {response} {streams:?}", call.full_name())
        }));
    }
    properties
}

/// Returns the released properties that the current protocol lacks.
fn incompatible_changes(released: &DescriptorPool, current: &DescriptorPool) -> Vec<String> {
    let current_properties = properties(current);
    let released_properties = properties(released).into_iter();
    released_properties.filter(|property| !current_properties.contains(property)).collect()
}

#[test]
fn the_protocol_is_compatible_with_the_released_file() {
    assert_eq!(incompatible_changes(&released(), &current_protocol()), Vec::<String>::new());
}

#[test]
fn incompatible_changes_of_a_released_file_are_detected() {
    let text = std::fs::read_to_string(folder().join("released/policy_v1.proto"));
    let text = text.expect("the released file");
    let check = |from: &str, to: &str, breaks: bool| {
        let changed = text.replacen(from, to, 1);
        assert_ne!(changed, text, "nothing to change: {from}");
        let folder = std::env::temp_dir().join(format!("policy-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        std::fs::write(folder.join("changed.proto"), changed).expect("written");
        let changed = compiled(&folder, "changed.proto");
        std::fs::remove_dir_all(folder).expect("its own folder");
        assert_eq!(!incompatible_changes(&released(), &changed).is_empty(), breaks, "{to}");
    };
    check("uint32 horizon = 8;", "uint32 horizon = 80;", true);
    check("uint32 horizon = 8;", "uint32 chunk = 8;", true);
    check("uint32 horizon = 8;", "uint64 horizon = 8;", true);
    check("uint32 horizon = 8;", "optional uint32 horizon = 8;", true);
    check("uint32 horizon = 8;", "", true);
    check("LANGUAGE_IGNORED = 3;", "LANGUAGE_IGNORED = 4;", true);
    check("rpc Reset(ResetRequest)", "rpc Reset(InferRequest)", true);
    check("rpc Infer(InferRequest)", "rpc Ask(InferRequest)", true);
    let with_new_field = "uint32 horizon = 8; uint32 later = 99;";
    check("uint32 horizon = 8;", with_new_field, false);
}

/// Returns a message with a value in every field of the descriptor.
fn filled(message: &MessageDescriptor) -> DynamicMessage {
    let mut full = DynamicMessage::new(message.clone());
    for field in message.fields() {
        let value = value_of(&field);
        match field.is_list() {
            true => full.set_field(&field, Value::List(vec![value.clone(), value])),
            false => full.set_field(&field, value),
        }
    }
    full
}

fn value_of(field: &FieldDescriptor) -> Value {
    let number = field.number();
    match field.kind() {
        Kind::Bool => Value::Bool(true),
        Kind::Uint32 => Value::U32(number),
        Kind::Uint64 => Value::U64(u64::MAX - u64::from(number)),
        Kind::Float => Value::F32(number as f32 + 0.5),
        Kind::Double => Value::F64(f64::from(number) + 0.25),
        Kind::String => Value::String(field.name().to_owned()),
        Kind::Bytes => Value::Bytes(field.name().to_owned().into()),
        Kind::Enum(values) => {
            Value::EnumNumber(values.values().last().map_or(0, |value| value.number()))
        }
        Kind::Message(message) => Value::Message(filled(&message)),
        other => panic!("{other:?} is a new kind: add its value here"),
    }
}

fn message(pool: &DescriptorPool, name: &str) -> MessageDescriptor {
    let name = format!("{PACKAGE}.{name}");
    pool.get_message_by_name(&name).expect("a message")
}

/// Checks that today's types decode an older peer's message completely, and that an
/// older peer decodes today's message despite its new fields.
fn check<T: Message + Default>(name: &str) {
    let (released, current_protocol) =
        (message(&released(), name), message(&current_protocol(), name));
    let older = filled(&released);
    let decoded = T::decode(older.encode_to_vec().as_slice()).expect("an older message");
    let back = DynamicMessage::decode(released.clone(), decoded.encode_to_vec().as_slice());
    assert_eq!(back.expect("the same message"), older, "{name}");

    let newer = T::decode(filled(&current_protocol).encode_to_vec().as_slice()).expect("a message");
    let read = DynamicMessage::decode(released, newer.encode_to_vec().as_slice());
    let read = read.expect("a newer message");
    for field in older.descriptor().fields().filter(|field| !is_message(field)) {
        assert_eq!(read.get_field(&field), older.get_field(&field), "{name}");
    }
}

fn is_message(field: &FieldDescriptor) -> bool {
    matches!(field.kind(), Kind::Message(_))
}

#[test]
fn older_and_newer_programs_understand_each_others_messages() {
    check::<policy::DescribeRequest>("DescribeRequest");
    check::<policy::DescribeResponse>("DescribeResponse");
    check::<policy::ResetRequest>("ResetRequest");
    check::<policy::ResetResponse>("ResetResponse");
    check::<policy::InferRequest>("InferRequest");
    check::<policy::InferResponse>("InferResponse");
    check::<policy::InferBatchRequest>("InferBatchRequest");
    check::<policy::InferBatchResponse>("InferBatchResponse");
}
