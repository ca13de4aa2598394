//! Ranks that run as threads of one process.

use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use trimip_core::engine::exchange::{Rank, Ranks};
use trimip_core::{Error, Result};

/// Time after which a silent rank counts as ended.
const PATIENCE: Duration = Duration::from_secs(120);

type Message = (usize, Vec<u8>);

/// One rank. `all_to_all` and `send` use separate channels.
pub struct Threads {
    this_rank: Rank,
    traded: Vec<Sender<Message>>,
    trades: Mutex<Inbox>,
    sent: Vec<Sender<Message>>,
    received: Mutex<Receiver<Message>>,
    /// Number of bytes sent by `all_to_all`.
    pub bytes: Mutex<u64>,
}

/// Received messages, grouped by sender. A rank may be one `all_to_all` ahead of another.
struct Inbox {
    receiver: Receiver<Message>,
    early: Vec<Vec<Vec<u8>>>,
}

impl Threads {
    /// Creates `count` connected ranks.
    pub fn new(count: usize) -> Vec<Arc<Self>> {
        let (traded, trades): (Vec<_>, Vec<_>) = (0..count).map(|_| channel()).unzip();
        let (sent, received): (Vec<_>, Vec<_>) = (0..count).map(|_| channel()).unzip();
        let ranks = trades.into_iter().zip(received).enumerate().map(|(rank, (receiver, received))| {
            let early = vec![Vec::new(); count];
            Arc::new(Self {
                this_rank: Rank { id: rank, size: count },
                traded: traded.clone(),
                trades: Mutex::new(Inbox { receiver, early }),
                sent: sent.clone(),
                received: Mutex::new(received),
                bytes: Mutex::new(0),
            })
        });
        ranks.collect()
    }
}

/// Returns the error for a rank whose thread has ended.
fn gone<E>(_: E) -> Error {
    Error::device("another rank has ended")
}

impl Ranks for Threads {
    fn rank(&self) -> Rank {
        self.this_rank
    }

    fn all_to_all(&self, out: &[&[u8]], into: &mut [Vec<u8>]) -> Result<()> {
        let others = || (0..self.this_rank.size).filter(|rank| *rank != self.this_rank.id);
        for to in others() {
            *self.bytes.lock().unwrap() += out[to].len() as u64;
            self.traded[to].send((self.this_rank.id, out[to].to_vec())).map_err(gone)?;
        }
        let Inbox { receiver, early } = &mut *self.trades.lock().unwrap();
        for from in others() {
            while early[from].is_empty() {
                let (sender, bytes) = receiver.recv_timeout(PATIENCE).map_err(gone)?;
                early[sender].push(bytes);
            }
            into[from] = early[from].remove(0);
        }
        Ok(())
    }

    fn broadcast(&self, bytes: &mut Vec<u8>) -> Result<()> {
        let own = if self.this_rank.id == 0 { bytes.clone() } else { Vec::new() };
        let mut into = vec![Vec::new(); self.this_rank.size];
        self.all_to_all(&vec![&own[..]; self.this_rank.size], &mut into)?;
        if self.this_rank.id != 0 {
            *bytes = std::mem::take(&mut into[0]);
        }
        Ok(())
    }

    fn send(&self, to: usize, bytes: &[u8]) -> Result<()> {
        self.sent[to].send((self.this_rank.id, bytes.to_vec())).map_err(gone)
    }

    fn try_receive(&self) -> Result<Option<Message>> {
        match self.received.lock().unwrap().try_recv() {
            Ok(message) => Ok(Some(message)),
            Err(TryRecvError::Empty) => Ok(None),
            Err(error) => Err(gone(error)),
        }
    }

    fn receive(&self) -> Result<Message> {
        self.received.lock().unwrap().recv_timeout(PATIENCE).map_err(gone)
    }
}
