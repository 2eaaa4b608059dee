// MicroPython's own virtual machine as a module on a serial port: bytes of its prompt on standard input and output.
// node micropython_serial.mjs MICROPYTHON.mjs HEAP_BYTES FLASH.py: FLASH.py holds its file system.
import fs from 'node:fs';

const [module, heap, flash] = process.argv.slice(2);
const {loadMicroPython} = await import(module);
const machine = await loadMicroPython({
    heapsize: Number(heap), linebuffer: false, stdout: (bytes) => process.stdout.write(Buffer.from(bytes)),
});
machine.runPython(fs.readFileSync(flash, 'utf8'));
machine.runPython('import os, sys\nos.mount(Flash(), "/flash")\nos.chdir("/flash")\nsys.path[:] = ["", "/flash/lib"]');
machine.replInit();

// This build cannot read ahead, so it is asked for no raw paste (CTRL-E A CTRL-A): "R 0" is what a prompt says that understands
// the question and has none.
const RAW_PASTE = [5, 65, 1];
let held = [];
function feed(byte) {
    if (machine.replProcessChar(byte)) {
        process.stdout.write('MPY: soft reboot\r\n');
        machine.replInit();
    }
}
for await (const chunk of process.stdin) {
    for (const byte of chunk) {
        if (byte === RAW_PASTE[held.length]) {
            held.push(byte);
            if (held.length === RAW_PASTE.length) {
                process.stdout.write('R\x00');
                held = [];
            }
            continue;
        }
        held.forEach(feed);
        held = [];
        feed(byte);
    }
}
