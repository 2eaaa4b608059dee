// Runs Python files in MicroPython's own virtual machine and lets the caller evaluate expressions there.
// node vm.mjs MICROPYTHON.mjs HEAP_BYTES FOLDER FILE...: each FILE is put below / in the machine's own file system.
// Then: one expression per line of standard input, its str() as one line of standard output.
import fs from 'node:fs';
import path from 'node:path';
import readline from 'node:readline';

const [module, heap, root, ...files] = process.argv.slice(2);
const {loadMicroPython} = await import(module);
const said = [];
const machine = await loadMicroPython({heapsize: Number(heap), stdout: (line) => said.push(line), linebuffer: true});
for (const file of files) {
    let folder = '';
    for (const part of path.dirname(file).split('/')) {
        folder += '/' + part;
        try { machine.FS.mkdir(folder); } catch { /* it is there */ }
    }
    machine.FS.writeFile('/' + file, fs.readFileSync(path.join(root, file), 'utf8'));
}
machine.runPython('import sys\nsys.path.append("/")');
for await (const line of readline.createInterface({input: process.stdin})) {
    try {
        machine.runPython(line);
    } catch (error) {
        said.push('ERROR ' + String(error.message).replaceAll('\n', ' | '));
    }
    process.stdout.write((said.length ? said.join('\\n') : '') + '\n');
    said.length = 0;
}
