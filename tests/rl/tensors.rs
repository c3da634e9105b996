//! Named tensors of checkpoints.

use omnidrones::rl::checkpoint::{Data, Tensors};

#[test]
fn a_tensor_of_another_shape_or_kind_is_refused_with_name_and_both_shapes() {
    let mut tensors = Tensors::new();
    tensors.insert("actor.0.weight", &[2, 3], vec![0.5f32; 6]).unwrap();
    let text = tensors.get::<f32>("actor.0.weight", &[3, 2]).unwrap_err().to_string();
    let wanted = "tensor actor.0.weight is f32 of shape [2, 3], but it must be f32 of shape [3, 2].";
    assert!(text.starts_with(wanted), "{text}");
    let text = tensors.take::<f64>("actor.0.weight", &[2, 3]).unwrap_err().to_string();
    assert!(text.contains("is f32 of shape [2, 3]") && text.contains("must be f64 of shape [2, 3]"), "{text}");
    let text = tensors.get::<f32>("actor.0.weigth", &[2, 3]).unwrap_err().to_string();
    assert!(text.contains("no tensor is called 'actor.0.weigth' (did you mean 'actor.0.weight'?)"), "{text}");
    assert!(tensors.none_left().unwrap_err().to_string().contains("actor.0.weight is f32"));
    assert_eq!(tensors.take::<f32>("actor.0.weight", &[2, 3]).unwrap(), vec![0.5; 6]);
    tensors.none_left().unwrap();
}

#[test]
fn a_shape_that_does_not_hold_the_values_is_refused() {
    let mut tensors = Tensors::new();
    // the last is 3 modulo 2⁶⁴
    for shape in [&[2, 2][..], &[], &[0], &[usize::MAX, 2], &[1 << 32, 1 << 32], &[5, 0x6666_6666_6666_6667]] {
        let text = tensors.insert("x", shape, vec![1u64, 2, 3]).unwrap_err().to_string();
        assert!(text.starts_with("number of values of tensor x is 3"), "{text}");
    }
    assert!(tensors.is_empty());
}

#[test]
fn a_name_is_new_short_and_printable() {
    let mut tensors = Tensors::new();
    tensors.insert("a", &[], vec![1u8]).unwrap();
    for bad in ["", "a", "__metadata__", "a\nb", "a\0", &"n".repeat(257)] {
        assert!(tensors.insert(bad, &[], vec![1u8]).is_err(), "{bad:?}");
    }
    tensors.insert("n".repeat(256), &[], vec![1u8]).unwrap();
    assert_eq!(tensors.len(), 2);
}

#[test]
fn equality_is_that_of_bits() {
    let nan = |payload: u32| Data::F32(vec![f32::from_bits(0x7f80_0000 | payload)]);
    assert_eq!(nan(1), nan(1));
    assert_ne!(nan(1), nan(2));
    assert_ne!(Data::F64(vec![0.0]), Data::F64(vec![-0.0]));
    assert_ne!(Data::F32(vec![0.0]), Data::F32(vec![0.0, 0.0]));
    assert_ne!(Data::F32(vec![]), Data::F64(vec![]));
}
