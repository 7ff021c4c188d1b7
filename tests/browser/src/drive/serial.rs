//! A device at a serial port of the browser, with a port for tests in place of Web Serial's: a browser without a person chooses none.

use crate::driver::Browser;
use anyhow::{Context, Result, ensure};
use protocol::{
    CommandReceiver, Envelope, Hello, MAX_FRAME_TO_HOST, Message, Packer, Received, Request, Sample, State,
    encode_envelope,
};
use serde_json::{Value, json};

const ENTER: &str = "\u{e007}";
const CONNECTION: u32 = 0x1234_5678;
const BATCHES: u32 = 40;
const BATCH: u32 = 20;

/// A port that answers every frame with the next of these, and then with the first again.
const PORT: &str = "const answers = arguments[0].map((one) => Uint8Array.from(one)); const [again] = answers; \
    const of = window.port = { written: [], isOpen: false, options: null, give: true }; \
    const open = () => ({ \
        open: async (options) => { of.isOpen = true; of.options = options; }, \
        close: async () => { of.isOpen = false; }, \
        readable: new ReadableStream({ start: (device) => { of.device = device; } }), \
        writable: new WritableStream({ write: (frame) => { of.written.push([...frame]); of.device.enqueue(answers.shift() ?? again); } }) }); \
    Object.defineProperty(navigator, 'serial', { configurable: true, value: { requestPort: async () => { \
        if (!of.give) throw new DOMException('nothing was chosen', 'NotFoundError'); return open(); } } }); \
    showTabs(); show('live');";

fn frames(messages: impl IntoIterator<Item = Message>) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    for (sequence, message) in (0..).zip(messages) {
        let mut buffer = [0; MAX_FRAME_TO_HOST];
        bytes.extend_from_slice(encode_envelope(&Envelope { boot_id: 1, sequence, message }, &mut buffer)?);
    }
    Ok(bytes)
}

fn samples(number: u32) -> Result<Message> {
    let mut packer = Packer::new(1_000);
    for i in 0..BATCH {
        let sample = Sample { position_counts: [0, 1_000], force_counts: [0, 20_000], repeats_force: false };
        packer.push(1_000 * u64::from(BATCH * number + i), State::Idle, u8::MAX, 0, sample);
    }
    Ok(Message::Samples(packer.flush().context("no samples")?))
}

/// The page greets the device, has it send samples and requests nothing else; a port that is not given, and a device of another version.
///
/// # Errors
/// What is otherwise.
pub fn check(browser: &Browser, address: &str) -> Result<String> {
    let mut streamed = greeting().to_vec();
    for number in 0..BATCHES {
        streamed.push(samples(number)?);
    }
    streamed.push(Message::Status(fake_device::status()));
    let whole = frames(streamed)?;
    let begins_at = frames(greeting())?.len();
    let answers = json!([&whole[..begins_at], &whole[begins_at..]]);

    browser.open(address)?;
    browser.until("document.querySelector('#open-example')")?;
    browser.run(PORT, json!([answers]))?;
    browser.run("port.give = false;", json!([]))?;
    browser.press("#watch", ENTER)?;
    browser.run("port.give = true;", json!([]))?;
    browser.press("#watch", ENTER)?;
    browser.until(&format!("live.counts && live.counts.samples === {}", BATCH * BATCHES))?;
    browser.until("document.querySelector('#main table').textContent.includes('0, 1 N') && document.querySelector('#main .plot .line')")?;
    let port_text = browser.run(
        "return JSON.stringify([port.written, port.options.baudRate, live.counts, document.getElementById('watched').textContent, \
            document.querySelectorAll('fieldset, .motion').length, document.getElementById('fault').hidden]);",
        json!([]),
    )?;
    let port_state: Value = serde_json::from_str(port_text.as_str().context("no answer")?)?;
    let written: Vec<Vec<u8>> = serde_json::from_value(port_state[0].clone())?;
    let mut receiver = CommandReceiver::new();
    let mut requests = Vec::new();
    for received in receiver.feed(&written.concat()) {
        let Received::Frame(command) = received else { anyhow::bail!("a damaged frame: {written:?}") };
        requests.push((command.connection, command.request));
    }
    // A page that is given no processor time for long takes the device for silent and greets it again.
    let wanted_requests = [(0, Request::Hello), (CONNECTION, Request::Stream { enable: true })];
    ensure!(
        requests.starts_with(&wanted_requests)
            && requests.iter().all(|request| wanted_requests.contains(request)),
        "requested: {requests:?}"
    );
    ensure!(port_state[1] == json!(460_800), "rate {}", port_state[1]);
    ensure!(
        port_state[2]["state"] == json!("Idle") && port_state[2]["samples_missing"] == json!(0),
        "{}",
        port_state[2]
    );
    ensure!(port_state[3] == json!("Watching."), "{}", port_state[3]);
    ensure!(port_state[4] == json!(0), "motion is offered without the program");
    ensure!(port_state[5] == json!(true), "a port that was not chosen is reported as a fault");
    browser.press("#watch", ENTER)?;
    browser
        .until("!port.isOpen && document.getElementById('watched').textContent === 'The port is closed.'")?;

    let version = protocol::VERSION + 1;
    let other_version = Message::Hello(Hello { protocol_version: version, ..fake_device::hello() });
    browser.open(address)?;
    browser.until("document.querySelector('#open-example')")?;
    browser.run(PORT, json!([[frames([other_version])?]]))?;
    browser.press("#watch", ENTER)?;
    browser.until(&format!(
        "!port.isOpen && document.getElementById('watched').textContent.includes('protocol version {version}')"
    ))?;
    Ok(format!(
        "{} samples; the page greets, has samples sent and requests nothing else; another version is named",
        BATCH * BATCHES
    ))
}

fn greeting() -> [Message; 2] {
    [Message::Hello(fake_device::hello()), Message::Connected { connection: CONNECTION }]
}
