// Runs the Pico's firmware in rp2040js, with an I²S microphone on its pins that plays a file.
//
//   node run.mjs JOB.json
//
//   { "program": "pico", "sound": "in.pcm", "folder": "out", "stack": [lowest, past the highest], "events": [...],
//     "flash": [[address, byte], ...], "milliseconds": 5000 }
//
// The sound is 16 kHz, i16, low byte first. Into the folder go usb.wire and uart.wire, what the board sent, pulses.json, what its servo
// pins did ([pin, when it rose, how long it was high], µs), and report.json. Events are what
// the host does, each at its millisecond since the sound began (the microphone has settled, the program has started), in order:
//
//   { "ms": 20, "usb": "hex bytes" }, { "ms": 30, "uart": "hex bytes" }, { "ms": 40, "open": false }, { "ms": 50, "reading": false },
//   { "ms": 60, "fault": true }: the processor takes a hard fault; the report says when
//
// What the emulator lacks, and who steps in:
//   the ROM                not to be had: execution begins where the ROM would jump, at the program's vector table;
//   PIO's clock divider    its state machines run as fast as may be: this file steps them at the divisor that the program set;
//   the bit in a vector    that says "Thumb" stays in the program counter, and jump tables miss by one: taken off here;
//   the host's DTR         is sent to the device instead of its serial interface: sent here;
//   the flash cache        every access takes as long as RAM: `Cache` adds what a miss takes.
import { readFileSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import {
  ConsoleLogger,
  createSetupPacket,
  DataDirection,
  GPIOPinState,
  LogLevel,
  RP2040,
  SetupRecipient,
  SetupType,
  USBCDC,
} from 'rp2040js';

const FLASH = 0x10000000;
const VECTORS = 0x10000100;
const [CLOCK, SELECT, DATA, LED] = [16, 17, 18, 25];
const SERVOS = [2, 3, 4, 5, 6, 7];
const HARD_FAULT = 3;
/** Bits of a microphone's word below those that the firmware makes a sample of. */
const BELOW = 13;
/** Samples while a microphone settles: 300 ms. In the first slot no microphone can see where it began. */
const SETTLING = 4800 - 1;

function load(mcu, path) {
  const elf = readFileSync(path);
  const [table, size, count] = [elf.readUInt32LE(28), elf.readUInt16LE(42), elf.readUInt16LE(44)];
  for (let i = 0; i < count; i++) {
    const header = table + i * size;
    const [type, offset, , to, bytes] = [0, 4, 8, 12, 16].map((at) => elf.readUInt32LE(header + at));
    if (type === 1 && bytes > 0) mcu.flash.set(elf.subarray(offset, offset + bytes), to - FLASH);
  }
}

/** The chip on the microphone's board: looks at word select when the bit clock rises, puts out a bit when it falls. */
class Microphone {
  constructor(mcu, samples) {
    this.mcu = mcu;
    this.samples = samples;
    this.slots = 0;
    this.select = false;
    this.word = 0;
    this.noise = 1;
    mcu.gpio[CLOCK].addListener((state) => (state === GPIOPinState.High ? this.rise() : this.fall()));
  }

  rise() {
    const select = this.mcu.gpio[SELECT].value === GPIOPinState.High;
    if (select !== this.select) {
      this.select = select;
      // It answers in the left slot alone; in the other the line floats, here full of ones.
      this.word = select ? -1 : this.next();
    }
  }

  fall() {
    this.mcu.gpio[DATA].setInputValue(this.word < 0);
    this.word <<= 1;
  }

  /** 24 bits, of which the lowest are noise. */
  next() {
    const at = this.slots++ - SETTLING;
    this.noise = (Math.imul(this.noise, 1664525) + 1013904223) >>> 0;
    // While it settles it swings from one end to the other.
    const sample = at < 0 ? (this.noise >> 16) | 0 : at < this.samples.length ? this.samples[at] : 0;
    return (sample << BELOW) | ((this.noise >>> 19) & 0x1f00);
  }

  get over() {
    return this.slots - SETTLING - this.samples.length;
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

  constructor(mcu) {
    this.lines = new Uint32Array(2 * Cache.SETS).fill(0xffffffff);
    this.recent = new Uint8Array(Cache.SETS);
    this.waited = 0;
    this.misses = 0;
    for (const name of ['readUint8', 'readUint16', 'readUint32']) {
      const read = mcu[name].bind(mcu);
      mcu[name] = (address) => {
        if (address >>> 24 === 0x10) this.look(address >>> 3);
        return read(address);
      };
    }
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

const { program, sound, folder, stack, events, flash = [], milliseconds = 60000 } = JSON.parse(readFileSync(process.argv[2]));
const mcu = new RP2040();
mcu.logger = new ConsoleLogger(LogLevel.Error, true);
load(mcu, program);
for (const [address, byte] of flash) mcu.flash[address - FLASH] = byte;
mcu.core.VTOR = VECTORS;
mcu.core.SP = mcu.readUint32(VECTORS);
mcu.core.PC = mcu.readUint32(VECTORS + 4) & ~1;

const cache = new Cache(mcu);
const enter = mcu.core.exceptionEntry.bind(mcu.core);
mcu.core.exceptionEntry = (number) => {
  enter(number);
  mcu.core.PC &= ~1;
};

const pcm = readFileSync(sound);
const microphone = new Microphone(mcu, new Int16Array(pcm.buffer, pcm.byteOffset, pcm.length >> 1));
const said = { usb: [], uart: [] };
mcu.uart[0].onByte = (byte) => said.uart.push(byte);
const port = new USBCDC(mcu.usbCtrl);
// The emulator's host is done after 10 µs, whether the device has seen to the last packet or not; a real one asks again.
mcu.usbCtrl.writeDelayMicroseconds = mcu.usbCtrl.readDelayMicroseconds = 200;
/** SET_CONTROL_LINE_STATE: whether a program on the host has the port open. */
port.cdcSetControlLineState = (open = true) => {
  const request = { dataDirection: DataDirection.HostToDevice, type: SetupType.Class, recipient: SetupRecipient.Interface };
  mcu.usbCtrl.sendSetupPacket(createSetupPacket({ ...request, bRequest: 0x22, wValue: open ? 3 : 0, wIndex: 0, wLength: 0 }));
  port.initialized = true;
};
// A host that does not read leaves a packet where it is.
let reading = true;
const [updated, held] = [mcu.usbCtrl.DPRAMUpdated.bind(mcu.usbCtrl), new Map()];
mcu.usbCtrl.DPRAMUpdated = (offset, value) => {
  if (!reading && offset === 0x80 + 8 * port.inEndpoint) held.set(offset, value);
  else updated(offset, value);
};
const toSend = [];
// What the device is ready to take: a host asks again and again, here it waits for the host.
let awaited;
mcu.usbCtrl.onEndpointRead = (endpoint, size) => {
  if (endpoint > 0) awaited = { endpoint, size };
};
let faultUs;
function happen({ usb, uart, open, reading: reads, fault }) {
  if (fault) {
    faultUs = mcu.clock.nanos / 1000;
    mcu.core.exceptionEntry(HARD_FAULT);
  }
  if (usb) toSend.push(...Buffer.from(usb, 'hex'));
  if (uart) for (const byte of Buffer.from(uart, 'hex')) mcu.uart[0].feedByte(byte);
  if (open !== undefined) port.cdcSetControlLineState(open);
  if (reads !== undefined) {
    reading = reads;
    for (const [offset, value] of held) updated(offset, value);
    held.clear();
  }
}
port.onSerialData = (bytes) => said.usb.push(...bytes);
let [blinks, watchdog] = [0, 0];
mcu.peripherals[0x40058].onWatchdogTrigger = () => watchdog++;
mcu.gpio[LED].addListener(() => blinks++);

/** Pulses of the servo pins. The clock of an edge is that of the timer that made it, not of the instruction after it. */
const pulses = [];
for (const pin of SERVOS) {
  let rose;
  mcu.gpio[pin].addListener((state) => {
    const now = mcu.clock.nanos / 1000;
    if (state === GPIOPinState.High) rose = now;
    else if (rose !== undefined) {
      pulses.push([pin, rose, now - rose]);
      rose = undefined;
    }
  });
}

const pio = mcu.pio[0];
pio.run = () => {};
const { clock, core } = mcu;
const cycleNanos = () => 1e9 / mcu.clkSys;
let [cycles, awake, nextStep] = [0, 0, Infinity];
// Until a tenth of a second after the sound.
while (microphone.over < 1600 && clock.nanos < milliseconds * 1e6) {
  let spent;
  if (core.waiting) {
    // To whatever comes first: a timer, or the next step of PIO.
    const alarm = Math.max(1, Math.ceil(clock.nanosToNextAlarm / cycleNanos()));
    spent = Math.max(1, Math.min(alarm, Math.ceil(nextStep - cycles)));
  } else {
    spent = core.executeInstruction() + cache.take();
    awake += spent;
  }
  cycles += spent;
  clock.tick(spent * cycleNanos());
  if (!pio.stopped) {
    const machine = pio.machines[0];
    const period = machine.clockDivInt + machine.clockDivFrac / 256;
    if (nextStep === Infinity) nextStep = cycles;
    for (; nextStep <= cycles; nextStep += period) pio.step();
  }
  while (events.length > 0 && microphone.over + microphone.samples.length >= events[0].ms * 16) happen(events.shift());
  if (awaited && toSend.length > 0) {
    const { endpoint, size } = awaited;
    awaited = undefined;
    mcu.usbCtrl.endpointReadDone(endpoint, Uint8Array.from(toSend.splice(0, size)));
  }
}
for (const [name, bytes] of Object.entries(said)) writeFileSync(join(folder, `${name}.wire`), Uint8Array.from(bytes));
writeFileSync(join(folder, 'pulses.json'), JSON.stringify(pulses));
const bitClock = (mcu.clkSys / (pio.machines[0].clockDivInt + pio.machines[0].clockDivFrac / 256)) / 2;
// cortex-m-rt painted the stack; what was used lost its paint.
let lowest = stack[0];
while (lowest < stack[1] && mcu.readUint32(lowest) === 0xcccccccc) lowest += 4;
const report = { clockHz: mcu.clkSys, faultUs, cycles, awake, misses: cache.misses, blinks, watchdog, bitClock, stackUsed: stack[1] - lowest, stackSize: stack[1] - stack[0] };
writeFileSync(join(folder, 'report.json'), JSON.stringify(report));
process.exit(0);
