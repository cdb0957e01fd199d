// Browsers start no web worker from file://. This one runs its script in a hidden frame, so that the search works from disk.
if (location.protocol === "file:") {
  window.IFrameWorker = class extends EventTarget {
    constructor(url) {
      super()
      const frame = document.createElement("iframe")
      frame.hidden = true
      document.body.append(frame)
      this.frame = frame.contentWindow
      this.waiting = []
      this.frame.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }))
      const script = frame.contentDocument.createElement("script")
      script.src = url
      script.onload = () => this.start()
      frame.contentDocument.body.append(script)
    }

    start() {
      const waiting = this.waiting
      this.waiting = null
      waiting.forEach((data) => this.postMessage(data))
    }

    postMessage(data) {
      if (this.waiting) this.waiting.push(data)
      else this.frame.dispatchEvent(new MessageEvent("message", { data }))
    }

    terminate() {
      this.frame.frameElement.remove()
    }
  }
  window.Worker = window.IFrameWorker
}
