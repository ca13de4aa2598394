//! The example of `trimip-view` serves the page of a model.

#[allow(dead_code)]
#[path = "../../trimip-view/examples/viewer.rs"]
mod viewer;

use std::io::{Read, Write};
use std::net::TcpStream;
use trimip_tests::binary::{run, tiny_and};

#[test]
fn the_example_of_the_crate_serves_the_page() {
    let folder = tempfile::tempdir().unwrap();
    let answer = run(folder.path(), &tiny_and(&["--out", "run"]));
    assert_eq!(answer.code, Some(0), "{answer:?}");
    let server = viewer::open(&folder.path().join("run")).unwrap();
    let (host, path) = server.address.strip_prefix("http://").unwrap().split_once('/').unwrap();
    let mut stream = TcpStream::connect(host).unwrap();
    write!(stream, "GET /{path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 200") && answer.contains("<canvas"), "{answer}");
}
