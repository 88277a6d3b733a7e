// The Pico's chip and flash, as rp2040js plays them, with what it lacks:
//
//   the ROM                not to be had: UF2 files are written to flash as the ROM would, execution begins where it would jump;
//   faults                 an address where nothing is, or an instruction that is none, raises a hard fault; one inside that, or a stack that
//                          has left the RAM, locks the processor up until the watchdog fires;
//   a new start            by the watchdog or by the program: another chip with the same RAM, the watchdog's own memory, and flash as it was at first;
//   SysTick                does not end a sleep: `sleeps` does it;
//   the bit in a vector    that says "Thumb" stays in the program counter, and jump tables miss by one: taken off here;
//   speed                  a loop that only counts down while interrupts are off is passed over at once, its cycles counted;
//   the flash cache        every access takes as long as RAM: `Cache` adds what a miss takes.
import { readFileSync } from 'node:fs';
import { ConsoleLogger, LogLevel, RP2040 } from 'rp2040js';

const FLASH = 0x10000000;
const VECTORS = 0x10000100;
const RAM_END = 0x20042000;
const HARD_FAULT = 3;
/** Where the emulator keeps the watchdog among its peripherals. */
const WATCHDOG = 0x40058;
/** The register and the bit by which a program starts itself anew. */
const AIRCR = 0xe000ed0c;
const SYSRESETREQ = 1 << 2;
/** RP2040's family of UF2 files. */
const FAMILY = 0xe48bff56;

/** Segments of an ELF file and blocks of a UF2 file to flash. */
function load(flash, path) {
  const file = readFileSync(path);
  if (file.toString('latin1', 0, 4) === 'UF2\n') {
    for (let at = 0; at < file.length; at += 512) {
      const [second, flags, to, bytes, , , family] = [4, 8, 12, 16, 20, 24, 28].map((field) => file.readUInt32LE(at + field));
      const good = second === 0x9e5d5157 && file.readUInt32LE(at + 508) === 0x0ab16f30 && flags === 0x2000;
      // As the ROM: whole pages of 256 bytes, of its own family.
      if (!good || family !== FAMILY || bytes !== 256 || to % 256 !== 0) throw new Error(`${path}: block ${at / 512} is not for this chip`);
      flash.set(file.subarray(at + 32, at + 32 + bytes), to - FLASH);
    }
    return;
  }
  const [table, size, count] = [file.readUInt32LE(28), file.readUInt16LE(42), file.readUInt16LE(44)];
  for (let i = 0; i < count; i++) {
    const header = table + i * size;
    const [type, offset, , to, bytes] = [0, 4, 8, 12, 16].map((at) => file.readUInt32LE(header + at));
    if (type === 1 && bytes > 0) flash.set(file.subarray(offset, offset + bytes), to - FLASH);
  }
}

/**
 * The cache between processor and flash (RP2040 datasheet, 2.6.3): 16 KiB, two ways, lines of 8 bytes, a hit takes no time of its own. A miss
 * reads a line from the flash chip as boot2 sets it up: 8 clocks of address and mode, 4 idle, 16 of data, each CLOCK_DIVISOR cycles.
 */
class Cache {
  static CLOCK_DIVISOR = 2;
  static MISS = 28 * Cache.CLOCK_DIVISOR;
  static SETS = 1024;

  constructor() {
    this.lines = new Uint32Array(2 * Cache.SETS).fill(0xffffffff);
    this.recent = new Uint8Array(Cache.SETS);
    this.waited = 0;
    this.misses = 0;
  }

  look(line) {
    const set = line % Cache.SETS;
    const { lines, recent } = this;
    if (lines[2 * set] === line) recent[set] = 0;
    else if (lines[2 * set + 1] === line) recent[set] = 1;
    else {
      recent[set] = 1 - recent[set];
      lines[2 * set + recent[set]] = line;
      this.waited += Cache.MISS;
      this.misses++;
    }
  }

  /** Cycles waited since the last call. */
  take() {
    const { waited } = this;
    this.waited = 0;
    return waited;
  }
}

/** An access to an address where nothing is, or nothing that can be written. */
class BusError extends Error {}

/** One life of the chip, from a start to the next. */
class Chip {
  constructor(flash, ram) {
    const mcu = new RP2040();
    this.mcu = mcu;
    mcu.logger = new ConsoleLogger(LogLevel.Error, true);
    mcu.flash.set(flash);
    if (ram) mcu.sram.set(ram);
    this.cache = new Cache();
    this.lockedUp = false;
    /** Why the chip is to start anew. */
    this.reset = undefined;
    this.watchMemory();
    mcu.core.VTOR = VECTORS;
    mcu.core.SP = mcu.readUint32(VECTORS);
    mcu.core.PC = mcu.readUint32(VECTORS + 4) & ~1;
    const enter = mcu.core.exceptionEntry.bind(mcu.core);
    mcu.core.exceptionEntry = (number) => {
      enter(number);
      mcu.core.PC &= ~1;
    };
    mcu.onBreak = () => (this.undefinedInstruction = true);
    const watchdog = mcu.peripherals[WATCHDOG];
    watchdog.onWatchdogTrigger = () => {
      // Its alarm would come again at once, for ever.
      watchdog.alarm.enable = false;
      this.reset = 'watchdog';
    };
  }

  watchMemory() {
    const { mcu, cache } = this;
    for (const name of ['readUint8', 'readUint16', 'readUint32']) {
      const read = mcu[name].bind(mcu);
      mcu[name] = (address) => {
        const top = address >>> 24;
        if (top === 0x10) cache.look(address >>> 3);
        else if (top === 0x20 ? address >>> 0 >= RAM_END : (top > 0 && top < 0x10) || (top >= 0x1c && top < 0x40)) throw new BusError();
        return read(address);
      };
    }
    for (const name of ['writeUint8', 'writeUint16', 'writeUint32']) {
      const write = mcu[name].bind(mcu);
      mcu[name] = (address, value) => {
        const top = address >>> 24;
        if (top === 0x20 ? address >>> 0 >= RAM_END : top < 0x14 || (top >= 0x1c && top < 0x40)) throw new BusError();
        if (address >>> 0 === AIRCR && value & SYSRESETREQ) this.reset = 'program';
        write(address, value);
      };
    }
  }

  /** Whether the processor waits for an interrupt; SysTick's is one too. */
  get sleeps() {
    const { core } = this.mcu;
    if (core.pendingSystick) core.waiting = false;
    return core.waiting;
  }

  /** An instruction; how many cycles it took. */
  step() {
    const { core } = this.mcu;
    const passed = core.PM ? this.countDown() : 0;
    if (passed > 0) return passed;
    try {
      const cycles = core.executeInstruction();
      if (this.undefinedInstruction) {
        this.undefinedInstruction = false;
        core.PC -= 2;
        this.fault();
      }
      return cycles + this.cache.take();
    } catch (error) {
      if (!(error instanceof BusError)) throw error;
      this.fault();
      return 1;
    }
  }

  /** Takes some thousand turns of a loop of `subs rN, #1`, `bne` and perhaps a `nop` at once, if one is ahead; their cycles. */
  countDown() {
    const { mcu } = this;
    const { core } = mcu;
    const [at, flash] = [core.PC - FLASH, mcu.flashView];
    if (at < 2 || at + 4 > mcu.flash.length) return 0;
    const [subs, bne] = [flash.getUint16(at, true), flash.getUint16(at + 2, true)];
    if ((subs & 0xf8ff) !== 0x3801 || bne >>> 8 !== 0xd1) return 0;
    const back = 6 + ((bne << 24) >> 23);
    const nop = back === -2 && flash.getUint16(at - 2, true) === 0xbf00;
    if (back !== 0 && !nop) return 0;
    const register = (subs >>> 8) & 7;
    const turns = Math.min((core.registers[register] >>> 0) - 1, 5000);
    if (turns <= 0) return 0;
    core.registers[register] -= turns;
    return turns * (nop ? 4 : 3);
  }

  fault() {
    const { core } = this.mcu;
    try {
      if (core.IPSR === HARD_FAULT) this.lockedUp = true;
      else core.exceptionEntry(HARD_FAULT);
    } catch (error) {
      if (!(error instanceof BusError)) throw error;
      this.lockedUp = true;
    }
  }
}

/** What stays when the chip starts anew. */
export class Board {
  constructor(files) {
    this.flash = new Uint8Array(16 << 20).fill(0xff);
    for (const file of files) load(this.flash, file);
  }

  /** A chip that has just been switched on, or started anew. */
  boot() {
    const before = this.chip?.mcu;
    this.chip = new Chip(this.flash, before?.sram);
    if (before) {
      const [old, watchdog] = [before, this.chip.mcu].map((mcu) => mcu.peripherals[WATCHDOG]);
      watchdog.scratchData.set(old.scratchData);
      watchdog.reason = old.reason;
    }
    return this.chip;
  }
}

/** Writes a half-word where a program cannot, into flash; until the chip starts anew. */
export function poke(mcu, address, half) {
  if (address >= FLASH && address < FLASH + mcu.flash.length) mcu.flashView.setUint16(address - FLASH, half, true);
  else mcu.writeUint16(address, half);
}
