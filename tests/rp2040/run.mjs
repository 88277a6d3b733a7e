// Runs the Pico's firmware in rp2040js, with an I²S microphone on its pins that plays a file, or an amplifier's voltage at its ADC.
//
//   node run.mjs JOB.json
//
//   { "flash": ["pico.uf2", "model.uf2"], "sound": "in.pcm", "folder": "out", "stack": [lowest, past the highest], "events": [...],
//     "restarts": 1, "milliseconds": 5000 }
//
// What is in flash are UF2 files, or a program as an ELF file. The sound is 16 kHz, i16, low byte first; it begins anew with the chip, and so
// many new starts are waited for. Into the folder go usb.wire and uart.wire, what the board sent, pulses.json, what its servo pins did
// ([pin, when it rose, how long it was high], µs since the first start), and report.json. Events are what happens, each at its millisecond since the sound
// began (the microphone has settled, the program has started), in order:
//
//   { "ms": 20, "usb": "hex bytes" }, { "ms": 30, "uart": "hex bytes" }, { "ms": 40, "open": false }, { "ms": 50, "reading": false },
//   { "ms": 60, "write": [[address, half-word], ...] }: the program itself is changed, until the next start
//   { "ms": 70, "fault": true }: the processor takes a hard fault; the report says when
//
// With "adc": true the sound is a file of 12-bit counts (u16, low byte first), eight for each sample of sound, the 300 ms while a microphone
// settles too.
//
// What the emulator lacks, and who steps in (chip.mjs has more):
//   PIO's clock divider    its state machines run as fast as may be: this file steps them at the divisor that the program set;
//   the ADC's clock        its own alarms come late by an instruction each time: counts are handed over here, at the divisor that the program set;
//   the host's DTR         is sent to the device instead of its serial interface: sent here.
import { readFileSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { createSetupPacket, DataDirection, GPIOPinState, SetupRecipient, SetupType, USBCDC } from 'rp2040js';
import { Board, poke } from './chip.mjs';

const [CLOCK, SELECT, DATA, LED] = [16, 17, 18, 25];
const SERVOS = [2, 3, 4, 5, 6, 7];
/** Bits of a microphone's word below those that the firmware makes a sample of. */
const BELOW = 13;
/** Samples while a microphone settles: 300 ms. In the first slot no microphone can see where it began. */
const SETTLING = 4800 - 1;

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

  /** Samples since it has settled. */
  get position() {
    return this.slots - SETTLING;
  }

  get over() {
    return this.position - this.samples.length;
  }
}

/** An amplifier at GP26, heard by the ADC's own clock. */
class Voltage {
  static FACTOR = 8;
  static CLOCK_HZ = 48e6;

  constructor({ adc }, counts) {
    this.adc = adc;
    this.counts = counts;
    this.place = 0;
    /** The ADC's cycles since the last count. */
    this.waited = 0;
    adc.onADCRead = () => {};
    adc.multiShotAlarm.schedule = () => (adc.busy = true);
  }

  /** Of the ADC's cycles so many pass until the next count. */
  get next() {
    return this.adc.enabled && this.adc.busy ? this.adc.divider - this.waited : Infinity;
  }

  pass(cycles) {
    if (this.next === Infinity) return;
    const { adc, counts } = this;
    for (this.waited += cycles; this.next <= 0; this.place++) {
      if (adc.activeChannel !== 0) throw new Error(`the ADC listens to input ${adc.activeChannel}`);
      this.waited -= adc.divider;
      adc.completeADCRead(counts[Math.min(this.place, counts.length - 1)], false);
    }
  }

  get position() {
    return this.place / Voltage.FACTOR - (SETTLING + 1);
  }

  get over() {
    return (this.place - this.counts.length) / Voltage.FACTOR;
  }
}

/** The computer at the other end of USB and UART. */
class Host {
  constructor(chip, said) {
    const { mcu } = chip;
    this.chip = chip;
    this.mcu = mcu;
    this.toSend = [];
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
    port.onSerialData = (bytes) => said.usb.push(...bytes);
    this.port = port;
    // A host that does not read leaves a packet where it is.
    this.reading = true;
    this.held = new Map();
    this.updated = mcu.usbCtrl.DPRAMUpdated.bind(mcu.usbCtrl);
    mcu.usbCtrl.DPRAMUpdated = (offset, value) => {
      if (!this.reading && offset === 0x80 + 8 * port.inEndpoint) this.held.set(offset, value);
      else this.updated(offset, value);
    };
    // What the device is ready to take: a host asks again and again, here it waits for the host.
    mcu.usbCtrl.onEndpointRead = (endpoint, size) => {
      if (endpoint > 0) this.awaited = { endpoint, size };
    };
  }

  happen({ usb, uart, open, reading, write = [], fault }) {
    const { mcu } = this;
    if (usb) this.toSend.push(...Buffer.from(usb, 'hex'));
    if (uart) for (const byte of Buffer.from(uart, 'hex')) mcu.uart[0].feedByte(byte);
    if (open !== undefined) this.port.cdcSetControlLineState(open);
    if (reading !== undefined) {
      this.reading = reading;
      for (const [offset, value] of this.held) this.updated(offset, value);
      this.held.clear();
    }
    for (const [address, half] of write) poke(mcu, address, half);
    if (fault) {
      report.faultUs = nanos / 1000;
      this.chip.fault();
    }
  }

  send() {
    if (!this.awaited || this.toSend.length === 0) return;
    const { endpoint, size } = this.awaited;
    this.awaited = undefined;
    this.mcu.usbCtrl.endpointReadDone(endpoint, Uint8Array.from(this.toSend.splice(0, size)));
  }
}

const { flash, sound, adc = false, folder, stack, events, restarts = 0, milliseconds = 60000 } = JSON.parse(readFileSync(process.argv[2]));
const pcm = readFileSync(sound);
const samples = new (adc ? Uint16Array : Int16Array)(pcm.buffer, pcm.byteOffset, pcm.length >> 1);
const said = { usb: [], uart: [] };
const board = new Board(flash);
const report = { cycles: 0, awake: 0, misses: 0, blinks: 0, starts: [] };
let nanos = 0;

/** Pulses of the servo pins. The clock of an edge is that of the timer that made it, not of the instruction after it. */
const pulses = [];

function watchServos(mcu, now) {
  for (const pin of SERVOS) {
    let rose;
    mcu.gpio[pin].addListener((state) => {
      if (state === GPIOPinState.High) rose = now();
      else if (rose !== undefined) {
        pulses.push([pin, rose, now() - rose]);
        rose = undefined;
      }
    });
  }
}

/** From a start to the next: whether there is one. */
function live() {
  const chip = board.boot();
  const { mcu } = chip;
  const host = new Host(chip, said);
  const microphone = new (adc ? Voltage : Microphone)(mcu, samples);
  mcu.gpio[LED].addListener(() => report.blinks++);
  const pio = mcu.pio[0];
  pio.run = () => {};
  const { clock, core } = mcu;
  const began = nanos;
  watchServos(mcu, () => (began + clock.nanos) / 1000);
  let [cycles, nextStep] = [0, Infinity];
  const cycleNanos = () => 1e9 / mcu.clkSys;
  // Until a tenth of a second after the sound.
  while ((microphone.over < 1600 || report.starts.length < restarts) && nanos < milliseconds * 1e6 && !chip.reset) {
    let spent;
    if (chip.sleeps || chip.lockedUp) {
      // To whatever comes first: a timer, the next step of PIO, or the ADC's next count.
      const alarm = Math.max(1, Math.ceil(clock.nanosToNextAlarm / cycleNanos()));
      spent = Math.max(1, Math.min(alarm, Math.ceil(nextStep - cycles), adc ? Math.ceil((microphone.next * mcu.clkSys) / Voltage.CLOCK_HZ) : Infinity));
    } else {
      spent = chip.step();
      report.awake += spent;
    }
    cycles += spent;
    clock.tick(spent * cycleNanos());
    nanos = began + clock.nanos;
    if (adc) microphone.pass((spent * Voltage.CLOCK_HZ) / mcu.clkSys);
    if (!pio.stopped) {
      const machine = pio.machines[0];
      const period = machine.clockDivInt + machine.clockDivFrac / 256;
      if (nextStep === Infinity) nextStep = cycles;
      for (; nextStep <= cycles; nextStep += period) pio.step();
    }
    while (events.length > 0 && microphone.position >= events[0].ms * 16) host.happen(events.shift());
    host.send();
  }
  report.cycles += cycles;
  report.misses += chip.cache.misses;
  report.clockHz = mcu.clkSys;
  if (adc) report.countClock = Voltage.CLOCK_HZ / mcu.adc.divider;
  else report.bitClock = mcu.clkSys / (pio.machines[0].clockDivInt + pio.machines[0].clockDivFrac / 256) / 2;
  if (!chip.reset) return false;
  report.starts.push({ why: chip.reset, ms: nanos / 1e6, lockedUp: chip.lockedUp, usb: said.usb.length, uart: said.uart.length });
  return true;
}

while (live());
for (const [name, bytes] of Object.entries(said)) writeFileSync(join(folder, `${name}.wire`), Uint8Array.from(bytes));
writeFileSync(join(folder, 'pulses.json'), JSON.stringify(pulses));
// cortex-m-rt painted the stack; what was used lost its paint.
const { mcu } = board.chip;
let lowest = stack[0];
while (lowest < stack[1] && mcu.readUint32(lowest) === 0xcccccccc) lowest += 4;
Object.assign(report, { stackUsed: stack[1] - lowest, stackSize: stack[1] - stack[0] });
writeFileSync(join(folder, 'report.json'), JSON.stringify(report));
process.exit(0);
