//! The memory behind the calibration store, as firmware would use it (uvc/PROTOCOL.md, "Calibration store"): two halves, one in use.
//! A write fills the other half, checks it, and writes its header last. Power may fail before any single write.

use crate::store::{ABORT, BEGIN, COMMIT, Command, MAX_BYTES, PAGE_BYTES, Page, SELECT, Status, StoreInfo};

#[derive(Clone, Debug, Default)]
struct Half {
    /// Written last: without it the half is empty.
    header: Option<Header>,
    data: Vec<u8>,
}

#[derive(Clone, Copy, Debug)]
struct Header {
    length: u32,
    crc: u32,
    generation: u32,
}

/// A write under way; forgotten when power fails.
#[derive(Clone, Copy, Debug)]
struct Session {
    length: u32,
    crc: u32,
    pages: u16,
}

/// The store of the software head.
#[derive(Clone, Debug, Default)]
pub struct Flash {
    halves: [Half; 2],
    session: Option<Session>,
    selected: u16,
    status: Option<Status>,
    /// Writes that still succeed, if power is to fail.
    power_left: Option<u32>,
}

impl Flash {
    /// Lets power fail before the write after `writes` more.
    pub fn fail_power_after(&mut self, writes: u32) {
        self.power_left = Some(writes);
    }

    /// Power is back: what was in working memory is gone.
    pub fn power_up(&mut self) {
        let halves = std::mem::take(&mut self.halves);
        *self = Self { halves, ..Self::default() };
    }

    fn current(&self) -> Option<(usize, Header)> {
        let headers = self.halves.iter().enumerate().filter_map(|(i, half)| {
            let header = half.header?;
            (crc32fast::hash(&half.data) == header.crc).then_some((i, header))
        });
        headers.max_by_key(|(_, header)| header.generation)
    }

    /// What the control StoreInfo answers.
    pub fn info(&self) -> StoreInfo {
        let header = self.current().map_or(Header { length: 0, crc: 0, generation: 0 }, |(_, header)| header);
        StoreInfo {
            length: header.length,
            crc: header.crc,
            generation: header.generation,
            page_bytes: 256,
            pages: 64, // 16 KiB; a calibration with its covariance has about 2 KiB
        }
    }

    /// What the control StoreStatus answers.
    pub fn status(&self) -> [u8; 4] {
        let pages = self.session.map_or(0, |session| session.pages).to_le_bytes();
        let status = self.status.unwrap_or(Status::Ok) as u8;
        [u8::from(self.session.is_some()), status, pages[0], pages[1]]
    }

    /// The selected page.
    pub fn page(&self) -> Option<Page> {
        let (half, _) = self.current()?;
        let start = usize::from(self.selected) * PAGE_BYTES;
        let rest = self.halves[half].data.get(start..).filter(|rest| !rest.is_empty())?;
        Some(Page { number: self.selected, data: rest[..rest.len().min(PAGE_BYTES)].to_vec() })
    }

    /// A command; false: refused, see the status.
    pub fn command(&mut self, bytes: &[u8; 12]) -> bool {
        let command = Command::decode(bytes);
        let result = match command.op {
            BEGIN => self.begin(&command),
            COMMIT => self.commit(&command),
            ABORT => {
                self.session = None;
                Ok(())
            }
            SELECT if usize::from(command.page) * PAGE_BYTES < self.info().length as usize => {
                self.selected = command.page;
                Ok(())
            }
            SELECT => Err(Status::WrongPage),
            _ => Err(Status::BadCommand),
        };
        self.done(result)
    }

    /// A page to write; false: refused, see the status.
    pub fn write_page(&mut self, bytes: &[u8]) -> bool {
        let result = self.take_page(bytes);
        self.done(result)
    }

    fn done(&mut self, result: Result<(), Status>) -> bool {
        self.status = result.err();
        result.is_ok()
    }

    fn powered(&mut self) -> Result<(), Status> {
        match &mut self.power_left {
            Some(0) => Err(Status::Memory),
            Some(left) => {
                *left -= 1;
                Ok(())
            }
            None => Ok(()),
        }
    }

    fn spare(&self) -> usize {
        self.current().map_or(0, |(half, _)| 1 - half)
    }

    fn begin(&mut self, command: &Command) -> Result<(), Status> {
        let length = usize::try_from(command.length).unwrap_or(usize::MAX);
        if length == 0 || length > (usize::from(self.info().pages) * PAGE_BYTES).min(MAX_BYTES) {
            return Err(Status::BadCommand);
        }
        self.powered()?;
        let spare = self.spare();
        self.halves[spare] = Half::default();
        self.session = Some(Session { length: command.length, crc: command.crc, pages: 0 });
        Ok(())
    }

    fn take_page(&mut self, bytes: &[u8]) -> Result<(), Status> {
        let session = self.session.ok_or(Status::NoSession)?;
        let Ok(page) = Page::decode(bytes) else { return Err(Status::PageCrc) };
        let spare = self.spare();
        let left = (session.length as usize).saturating_sub(self.halves[spare].data.len());
        if page.number != session.pages || page.data.len() != left.min(PAGE_BYTES) || left == 0 {
            return Err(Status::WrongPage);
        }
        self.powered()?;
        self.halves[spare].data.extend(page.data);
        self.session = Some(Session { pages: session.pages + 1, ..session });
        Ok(())
    }

    fn commit(&mut self, command: &Command) -> Result<(), Status> {
        let session = self.session.ok_or(Status::NoSession)?;
        let spare = self.spare();
        let data = &self.halves[spare].data;
        if (command.length, command.crc) != (session.length, session.crc) {
            return Err(Status::BadCommand);
        }
        if data.len() != session.length as usize {
            return Err(Status::Incomplete);
        }
        if crc32fast::hash(data) != session.crc {
            return Err(Status::WholeCrc);
        }
        self.powered()?;
        let generation = self.info().generation + 1;
        self.halves[spare].header = Some(Header { length: session.length, crc: session.crc, generation });
        self.session = None;
        Ok(())
    }
}
