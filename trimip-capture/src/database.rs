//! Counts from a COLMAP database, which is an SQLite file: the features of each picture and its verified matches. The reader covers only
//! the parts of the format (<https://www.sqlite.org/fileformat2.html>) that these counts need: scans of whole tables, and the first values
//! of their rows.

use std::{
    collections::BTreeMap,
    fs::File,
    io::{Read, Seek, SeekFrom},
    path::Path,
};

/// The first bytes of a database.
const MAGIC: &[u8; 16] = b"SQLite format 3\0";

/// Size of the file header, bytes. On page 1 it precedes the tree.
const HEADER: usize = 100;

/// Types of a table's b-tree pages: leaf and interior node.
const LEAF: u8 = 0x0d;
const NODE: u8 = 0x05;

/// Maximum number of pages that are read, so that reading also ends for a corrupt file whose pages refer to each other in a cycle.
const MOST_PAGES: usize = 10_000_000;

/// In COLMAP, the identifier of a pair is `first · PAIR + second`, where `first` and `second` are the numbers of the two pictures.
const PAIR: u64 = 2_147_483_647;

/// Counts of one picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Number of features.
    pub features: u64,
    /// Number of pictures that have verified matches with this one.
    pub pairs: u64,
    /// Largest number of verified matches with a single other picture.
    pub most: u64,
}

/// Returns the counts of all pictures by name; `None` if the file is not a COLMAP database.
pub fn counts(path: &Path) -> Option<BTreeMap<String, Counts>> {
    let mut file = Database::open(path)?;
    let roots = file.roots()?;
    let mut names: BTreeMap<u64, String> = BTreeMap::new();
    file.rows(*roots.get("images")?, &mut |id, values| {
        if let Some(Value::Text(name)) = values.get(1) {
            names.insert(id, name.clone());
        }
    })?;
    let mut counts: BTreeMap<u64, Counts> = BTreeMap::new();
    file.rows(*roots.get("keypoints")?, &mut |id, values| {
        counts.entry(id).or_default().features = values.get(1).and_then(Value::number).unwrap_or(0);
    })?;
    file.rows(*roots.get("two_view_geometries")?, &mut |pair, values| {
        let matches = values.get(1).and_then(Value::number).unwrap_or(0);
        if matches > 0 {
            for id in [pair / PAIR, pair % PAIR] {
                let counts = counts.entry(id).or_default();
                counts.pairs += 1;
                counts.most = counts.most.max(matches);
            }
        }
    })?;
    Some(names.into_iter().map(|(id, name)| (name, counts.get(&id).copied().unwrap_or_default())).collect())
}

/// A value of a row.
#[derive(Debug, PartialEq)]
enum Value {
    Number(u64),
    Text(String),
    Other,
}

impl Value {
    fn number(&self) -> Option<u64> {
        if let Self::Number(number) = self { Some(*number) } else { None }
    }
}

struct Database {
    file: File,
    page: usize,
}

impl Database {
    fn open(path: &Path) -> Option<Self> {
        let mut file = File::open(path).ok()?;
        let mut header = [0; HEADER];
        file.read_exact(&mut header).ok()?;
        // 65,536, the largest page size, does not fit in two bytes and is stored as 1.
        let page = match u16::from_be_bytes([header[16], header[17]]) {
            1 => 65_536,
            page => usize::from(page),
        };
        (header.starts_with(MAGIC) && page >= 512).then_some(Self { file, page })
    }

    /// Returns the root pages of the tables by table name.
    fn roots(&mut self) -> Option<BTreeMap<String, u32>> {
        let mut roots = BTreeMap::new();
        self.rows(1, &mut |_, values| {
            if let [Value::Text(kind), Value::Text(name), _, Value::Number(root), ..] = values
                && kind == "table"
            {
                roots.insert(name.clone(), u32::try_from(*root).unwrap_or(0));
            }
        })?;
        Some(roots)
    }

    fn read_page(&mut self, number: u32) -> Option<Vec<u8>> {
        let mut page = vec![0; self.page];
        let at = u64::from(number.checked_sub(1)?) * self.page as u64;
        self.file.seek(SeekFrom::Start(at)).ok()?;
        self.file.read_exact(&mut page).ok()?;
        Some(page)
    }

    /// Calls `take` with each row of a table: the number of the row and its first values.
    fn rows(&mut self, root: u32, take: &mut dyn FnMut(u64, &[Value])) -> Option<()> {
        let mut next = vec![root];
        let mut read = 0;
        while let Some(number) = next.pop() {
            read += 1;
            if read > MOST_PAGES {
                return None;
            }
            let page = self.read_page(number)?;
            let start = if number == 1 { HEADER } else { 0 };
            let kind = *page.get(start)?;
            let cells = usize::from(u16_at(&page, start + 3)?);
            let list = start + if kind == NODE { 12 } else { 8 };
            for cell in 0..cells {
                let at = usize::from(u16_at(&page, list + 2 * cell)?);
                let cell = page.get(at..)?;
                match kind {
                    NODE => next.push(u32::from_be_bytes(*cell.first_chunk()?)),
                    LEAF => {
                        let (_, cell) = varint(cell)?;
                        let (id, cell) = varint(cell)?;
                        take(id, &values(cell)?);
                    }
                    _ => return None,
                }
            }
            if kind == NODE {
                next.push(u32::from_be_bytes(*page.get(start + 8..)?.first_chunk()?));
            }
        }
        Some(())
    }
}

fn u16_at(page: &[u8], at: usize) -> Option<u16> {
    page.get(at..)?.first_chunk().map(|bytes| u16::from_be_bytes(*bytes))
}

/// Reads a number of 1 to 9 bytes; returns the number and the bytes after it.
fn varint(bytes: &[u8]) -> Option<(u64, &[u8])> {
    let mut value = 0_u64;
    for index in 0..9 {
        let byte = *bytes.get(index)?;
        if index == 8 {
            return Some((value << 8 | u64::from(byte), &bytes[9..]));
        }
        value = value << 7 | u64::from(byte & 0x7f);
        if byte & 0x80 == 0 {
            return Some((value, &bytes[index + 1..]));
        }
    }
    None
}

/// Returns the first values of a record, up to the end of the record's first page.
fn values(record: &[u8]) -> Option<Vec<Value>> {
    let (length, _) = varint(record)?;
    let header = record.get(..usize::try_from(length).ok()?)?;
    let (_, mut kinds) = varint(header)?;
    let mut body = &record[header.len()..];
    let mut values = Vec::new();
    while !kinds.is_empty() {
        let (kind, rest) = varint(kinds)?;
        kinds = rest;
        let size = match kind {
            0 | 8 | 9 => 0,
            1..=4 => kind as usize,
            5 => 6,
            6 | 7 => 8,
            12.. => usize::try_from((kind - 12) / 2).ok()?,
            _ => return None,
        };
        let Some(bytes) = body.get(..size) else { break };
        body = &body[size..];
        values.push(match kind {
            8 | 9 => Value::Number(kind - 8),
            1..=6 => Value::Number(bytes.iter().fold(0, |value, byte| value << 8 | u64::from(*byte))),
            13.. if kind % 2 == 1 => Value::Text(String::from_utf8_lossy(bytes).into_owned()),
            _ => Value::Other,
        });
    }
    Some(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Encodes values as an SQLite record.
    fn record(values: &[Value]) -> Vec<u8> {
        let (mut header, mut body) = (Vec::new(), Vec::new());
        for value in values {
            match value {
                Value::Other => header.push(0),
                Value::Number(number) => {
                    header.push(4);
                    body.extend((*number as u32).to_be_bytes());
                }
                Value::Text(text) => {
                    header.push(13 + 2 * text.len() as u8);
                    body.extend(text.bytes());
                }
            }
        }
        [vec![header.len() as u8 + 1], header, body].concat()
    }

    fn number(mut value: u64) -> Vec<u8> {
        let mut bytes = vec![(value & 0x7f) as u8];
        while value > 0x7f {
            value >>= 7;
            bytes.insert(0, (value & 0x7f) as u8 | 0x80);
        }
        bytes
    }

    /// Returns a leaf page of 512 bytes.
    fn leaf(start: usize, rows: &[(u64, Vec<Value>)]) -> Vec<u8> {
        let mut page = vec![0; 512];
        page[start] = LEAF;
        page[start + 3..start + 5].copy_from_slice(&(rows.len() as u16).to_be_bytes());
        let mut end = 512;
        for (index, (id, values)) in rows.iter().enumerate() {
            let record = record(values);
            let cell = [number(record.len() as u64), number(*id), record].concat();
            end -= cell.len();
            page[end..end + cell.len()].copy_from_slice(&cell);
            page[start + 8 + 2 * index..start + 10 + 2 * index].copy_from_slice(&(end as u16).to_be_bytes());
        }
        page
    }

    #[test]
    fn counts_are_those_of_the_tables() {
        let text = |text: &str| Value::Text(text.into());
        let table = |name: &str, root| {
            vec![text("table"), text(name), text(name), Value::Number(root), text("CREATE")]
        };
        let index = vec![text("index"), text("images"), text("x"), Value::Number(9), text("CREATE")];
        let mut first = leaf(
            HEADER,
            &[
                (1, table("images", 2)),
                (2, table("keypoints", 3)),
                (3, table("two_view_geometries", 4)),
                (4, index),
            ],
        );
        first[..16].copy_from_slice(MAGIC);
        first[16..18].copy_from_slice(&512_u16.to_be_bytes());
        let image = |name: &str| vec![Value::Other, text(name), Value::Number(1)];
        let rows = |count| vec![Value::Other, Value::Number(count), Value::Number(6)];
        let mut node = vec![0; 512];
        node[0] = NODE;
        node[3..5].copy_from_slice(&1_u16.to_be_bytes());
        node[8..12].copy_from_slice(&6_u32.to_be_bytes());
        node[12..14].copy_from_slice(&500_u16.to_be_bytes());
        node[500..504].copy_from_slice(&5_u32.to_be_bytes());
        let pages = [
            first,
            leaf(0, &[(1, image("a.jpg")), (2, image("b.jpg")), (3, image("c.jpg"))]),
            leaf(0, &[(1, rows(900)), (2, rows(800))]),
            node,
            leaf(0, &[(PAIR + 2, rows(70)), (PAIR + 3, rows(0))]),
            leaf(0, &[(2 * PAIR + 3, rows(30))]),
        ];
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("database.db");
        std::fs::write(&path, pages.concat()).unwrap();
        let found = counts(&path).unwrap();
        let of = |features, pairs, most| Counts { features, pairs, most };
        assert_eq!(found["a.jpg"], of(900, 1, 70));
        assert_eq!((found["b.jpg"], found["c.jpg"]), (of(800, 2, 70), of(0, 1, 30)));
        // A truncated file is rejected and causes no panic, wherever it is cut.
        for length in (0..pages.concat().len()).step_by(37) {
            std::fs::write(&path, &pages.concat()[..length]).unwrap();
            let _ = counts(&path);
        }
        std::fs::write(&path, "no database").unwrap();
        assert_eq!(counts(&path), None);
    }
}
