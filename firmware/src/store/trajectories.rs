//! The two banks: upload into the inactive one, checks, commit by name.

use protocol::cyphal::crc::Crc64;
use sha2::{Digest as _, Sha256};

use super::seal::Seal;
use super::storage::{Area, Slot, Storage};
use crate::credentials::{Digest, Peer};
use crate::fault::{Cause, Refusal};
use crate::settings::Settings;
use crate::spline::Spline;
use crate::trajectory_format::{self, FILE_LEN_MAX, FileName, Header};

/// The trajectory that may run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Committed {
    slot: Slot,
    sequence: u32,
    /// Its name.
    pub name: FileName,
    /// SHA-256 of its bytes.
    pub sha256: Digest,
    /// Header of the file.
    pub header: Header,
}

/// Upload in progress.
#[derive(Clone, Debug)]
struct Upload {
    /// The node that began the upload.
    owner: Peer,
    len: usize,
    crc64: Crc64,
    sha256: Sha256,
}

/// The two banks.
#[derive(Debug)]
pub struct TrajectoryStore {
    committed: Option<Committed>,
    /// Limits have changed since the commit.
    is_void: bool,
    upload: Option<Upload>,
}

impl TrajectoryStore {
    /// State before the storage is read.
    pub const fn new() -> Self {
        Self { committed: None, is_void: false, upload: None }
    }

    /// The trajectory that may run.
    pub const fn committed(&self) -> Option<&Committed> {
        if self.is_void { None } else { self.committed.as_ref() }
    }

    /// The committed trajectory may not run until it is committed again, which checks it against the limits of that
    /// time. The file stays.
    pub const fn void_commit(&mut self) {
        self.is_void = true;
    }

    /// Name of what is in the upload bank so far.
    pub fn uploaded(&self) -> Option<FileName> {
        let upload = self.upload.as_ref()?;
        Some(FileName { crc64: upload.crc64.get(), len: upload.len as u32 })
    }

    /// SHA-256 of what a commit of `name` refers to: the present upload, or the committed file if there is no upload.
    ///
    /// # Errors
    ///
    /// [`Cause::FileIncomplete`] without either.
    pub fn sha256_of(&self, name: FileName) -> Result<Digest, Refusal> {
        let committed = self.committed.filter(|committed| committed.name == name);
        match (&self.upload, committed) {
            (Some(upload), _) => Ok(upload.sha256.clone().finalize().into()),
            (None, Some(committed)) => Ok(committed.sha256),
            (None, None) => Err(Refusal::of(Cause::FileIncomplete)),
        }
    }

    /// Checks that the upload, if there is one, is of this node.
    ///
    /// # Errors
    ///
    /// [`Cause::UploadOfOther`].
    pub fn require_upload_of(&self, peer: Peer) -> Result<(), Refusal> {
        match &self.upload {
            Some(upload) if upload.owner != peer => Err(Refusal::of(Cause::UploadOfOther)),
            _ => Ok(()),
        }
    }

    /// Searches the committed trajectory after power on and loads it into `spline`.
    pub fn find(&mut self, storage: &impl Storage, settings: &Settings, spline: &mut Spline) {
        (self.committed, self.is_void, self.upload) = (None, false, None);
        let [a, b] = [Slot::A, Slot::B].map(|slot| (slot, Seal::read(storage, Area::BankSeal(slot))));
        let newest_first = match (a.1, b.1) {
            (Some(one), Some(two)) if two.sequence > one.sequence => [b, a],
            _ => [a, b],
        };
        for (slot, seal) in newest_first {
            let Some(Seal { sequence, len, crc64 }) = seal else { continue };
            let name = FileName { crc64, len };
            if let Ok((header, sha256)) = load(storage, slot, name, settings, spline) {
                self.committed = Some(Committed { slot, sequence, name, sha256, header });
                return;
            }
        }
        spline.clear(0);
    }

    /// The bank an upload goes to.
    fn upload_slot(&self) -> Slot {
        self.committed.map_or(Slot::A, |committed| committed.slot.other())
    }

    /// Takes the next piece of a file. A piece that came before is compared and accepted again, so a lost answer
    /// does no harm; offset 0 with other content begins a new file. Any write of a node to the upload of another
    /// node voids that upload.
    ///
    /// # Errors
    ///
    /// [`Cause::UploadOfOther`], [`Cause::UploadOutOfOrder`], [`Cause::FileTooLong`], [`Cause::StorageFailed`].
    pub fn write(
        &mut self,
        storage: &mut impl Storage,
        peer: Peer,
        offset: usize,
        data: &[u8],
    ) -> Result<(), Refusal> {
        if let Err(refusal) = self.require_upload_of(peer) {
            self.upload = None;
            return Err(refusal);
        }
        let slot = self.upload_slot();
        let bank = Area::Bank(slot);
        let end = offset.checked_add(data.len()).filter(|&end| end <= FILE_LEN_MAX);
        let Some(end) = end else { return Err(Refusal::of(Cause::FileTooLong)) };
        let have = self.upload.as_ref().map_or(0, |upload| upload.len);
        if self.upload.is_some() && end <= have && same(storage, bank, offset, data)? {
            return Ok(());
        }
        if offset == 0 {
            self.upload = None;
            storage.erase(Area::BankSeal(slot))?;
            storage.erase(bank)?;
            self.upload = Some(Upload { owner: peer, len: 0, crc64: Crc64::new(), sha256: Sha256::new() });
        }
        let Some(upload) = self.upload.as_mut().filter(|upload| upload.len == offset) else {
            return Err(Refusal::of(Cause::UploadOutOfOrder));
        };
        match storage.write(bank, offset, data) {
            Ok(()) => {
                upload.len = end;
                upload.crc64.update(data);
                upload.sha256.update(data);
                Ok(())
            }
            Err(error) => {
                self.upload = None;
                Err(error.into())
            }
        }
    }

    /// Reads back from the upload bank, else from the committed file; returns the bytes filled.
    ///
    /// # Errors
    ///
    /// [`Cause::StorageFailed`].
    pub fn read(&self, storage: &impl Storage, offset: usize, out: &mut [u8]) -> Result<usize, Refusal> {
        let (slot, len) = match (&self.upload, self.committed) {
            (Some(upload), _) => (self.upload_slot(), upload.len),
            (None, Some(committed)) => (committed.slot, committed.name.len as usize),
            (None, None) => return Ok(0),
        };
        let count = len.saturating_sub(offset).min(out.len());
        let Some(out) = out.get_mut(..count) else { return Ok(0) };
        if count > 0 {
            storage.read(Area::Bank(slot), offset, out)?;
        }
        Ok(count)
    }

    /// Checks the uploaded file, makes it the one that may run, and loads it into `spline`. A repeated commit of
    /// the committed file is accepted.
    ///
    /// # Errors
    ///
    /// The first check that fails. The trajectory that was committed before then stays, and is loaded.
    pub fn commit(
        &mut self,
        storage: &mut impl Storage,
        name: FileName,
        settings: &Settings,
        spline: &mut Spline,
    ) -> Result<(), Refusal> {
        if self.upload.is_none()
            && let Some(committed) = self.committed.filter(|committed| committed.name == name)
        {
            if self.is_void {
                load(storage, committed.slot, name, settings, spline)?;
                self.is_void = false;
            }
            return Ok(());
        }
        let outcome = self.seal(storage, name, settings, spline);
        if outcome.is_err() {
            self.reload(storage, settings, spline);
        }
        outcome
    }

    fn seal(
        &mut self,
        storage: &mut impl Storage,
        name: FileName,
        settings: &Settings,
        spline: &mut Spline,
    ) -> Result<(), Refusal> {
        let uploaded = self.uploaded().ok_or(Refusal::of(Cause::FileIncomplete))?;
        if uploaded.len != name.len {
            return Err(Refusal::of(Cause::FileIncomplete));
        }
        if uploaded.crc64 != name.crc64 {
            return Err(Refusal::of(Cause::FileChecksum));
        }
        let slot = self.upload_slot();
        let (header, sha256) = load(storage, slot, name, settings, spline)?;
        let sequence = self.committed.map_or(1, |committed| committed.sequence.saturating_add(1));
        let seal = Seal { sequence, len: name.len, crc64: name.crc64 };
        seal.write(storage, Area::BankSeal(slot))?;
        self.committed = Some(Committed { slot, sequence, name, sha256, header });
        (self.upload, self.is_void) = (None, false);
        Ok(())
    }

    /// Loads the committed trajectory into `spline` again; if that fails, it is no longer committed.
    pub fn reload(&mut self, storage: &impl Storage, settings: &Settings, spline: &mut Spline) {
        let loaded = self
            .committed
            .is_some_and(|committed| load(storage, committed.slot, committed.name, settings, spline).is_ok());
        if !loaded {
            self.committed = None;
            spline.clear(0);
        }
    }
}

impl Default for TrajectoryStore {
    fn default() -> Self {
        Self::new()
    }
}

fn same(storage: &impl Storage, area: Area, offset: usize, data: &[u8]) -> Result<bool, Refusal> {
    let mut bytes = [0; 64];
    for (index, piece) in data.chunks(64).enumerate() {
        let Some(bytes) = bytes.get_mut(..piece.len()) else { return Ok(false) };
        storage.read(area, offset + 64 * index, bytes)?;
        if bytes != piece {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Reads, names and checks the file of a bank.
fn load(
    storage: &impl Storage,
    slot: Slot,
    name: FileName,
    settings: &Settings,
    spline: &mut Spline,
) -> Result<(Header, Digest), Refusal> {
    let len = name.len as usize;
    let (mut crc64, mut sha256) = (Crc64::new(), Sha256::new());
    let read = |offset: usize, out: &mut [u8]| -> Result<(), Refusal> {
        storage.read(Area::Bank(slot), offset, out)?;
        crc64.update(out);
        sha256.update(&*out);
        Ok(())
    };
    let header = trajectory_format::decode(len, read, spline)?;
    if crc64.get() != name.crc64 {
        return Err(Refusal::of(Cause::FileChecksum));
    }
    trajectory_format::check(&header, spline, settings)?;
    Ok((header, sha256.finalize().into()))
}
