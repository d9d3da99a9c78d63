//! Stability prediction: model contract, preprocessing, ONNX engine.
