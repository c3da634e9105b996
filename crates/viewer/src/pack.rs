//! Columns of whole numbers as bytes, and bytes as text: what moves smoothly takes a byte or so per number.
//!
//! Each column is 0 and its one value where it never changes, else 1 and its second differences, the values before the first
//! being 0. Every number is a LEB128 of its zigzag code (sign in the lowest bit).

/// Bytes of columns of whole numbers.
pub fn pack(columns: impl Iterator<Item = Vec<i32>>) -> Vec<u8> {
    let mut bytes = Vec::new();
    for column in columns {
        match column.first() {
            Some(first) if column.iter().all(|x| x == first) => {
                write(0, &mut bytes);
                write(i64::from(*first), &mut bytes);
            }
            _ => {
                write(1, &mut bytes);
                let (mut value, mut slope) = (0, 0);
                for next in column.into_iter().map(i64::from) {
                    write(next - value - slope, &mut bytes);
                    (slope, value) = (next - value, next);
                }
            }
        }
    }
    bytes
}

/// Seven bits a byte, the lowest first.
fn write(number: i64, bytes: &mut Vec<u8>) {
    let mut rest = ((number << 1) ^ (number >> 63)) as u64;
    while rest > 127 {
        bytes.push(rest as u8 & 127 | 128);
        rest >>= 7;
    }
    bytes.push(rest as u8);
}

/// As text of the alphabet of RFC 4648, padded.
pub fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for part in bytes.chunks(3) {
        let of = |k: usize| u32::from(part.get(k).copied().unwrap_or(0));
        let bits = of(0) << 16 | of(1) << 8 | of(2);
        for k in 0..4 {
            let letter = LETTERS[(bits >> (18 - 6 * k) & 63) as usize];
            text.push(if k <= part.len() { letter.into() } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As the page reads them.
    fn unpack(bytes: &[u8], width: usize, frames: usize) -> Vec<Vec<i32>> {
        let mut numbers = Vec::new();
        let (mut value, mut place) = (0_u64, 0);
        for byte in bytes {
            value |= u64::from(byte & 127) << place;
            place += 7;
            if byte & 128 == 0 {
                numbers.push((value >> 1) as i64 ^ -((value & 1) as i64));
                (value, place) = (0, 0);
            }
        }
        let mut next = numbers.into_iter();
        let mut column = || {
            if next.next() == Some(0) {
                return vec![next.next().unwrap() as i32; frames];
            }
            let (mut value, mut slope) = (0, 0);
            let mut step = |difference: i64| {
                slope += difference;
                value += slope;
                value as i32
            };
            (0..frames).map(|_| step(next.next().unwrap())).collect()
        };
        (0..width).map(|_| column()).collect()
    }

    #[test]
    fn what_is_packed_is_unpacked_whatever_the_numbers() {
        let columns = vec![
            vec![7; 5],
            vec![0, 1, 4, 9, 16],
            vec![i32::MIN, i32::MAX, i32::MIN, 0, -1],
            vec![-64, 63, -64, 64, 8191],
        ];
        let bytes = pack(columns.clone().into_iter());
        assert_eq!(unpack(&bytes, 4, 5), columns);
        let slow = pack(std::iter::once((0..1000).map(|k: i32| k * k / 50).collect()));
        assert!(slow.len() <= 1010, "{} bytes for 1000 smooth numbers", slow.len());
    }

    #[test]
    fn text_is_that_of_rfc_4648() {
        for (plain, text) in [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")] {
            assert_eq!(base64(plain.as_bytes()), text);
        }
    }
}
